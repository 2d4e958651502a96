"""Disjoint sets of members 0, 1, ..., each known by its lowest member: kernels that others are made of.

``parents`` leads each member towards the lowest of its set, which leads to itself. To begin with each is alone.
"""

from __future__ import annotations

from heartcase.compiling.kernel import kernel

__all__ = ["join_two", "root_of"]


@kernel(cached=False)
def root_of(parents, one):
    """The lowest member of a member's set; ways to it are halved."""
    while parents[one] != one:
        parents[one] = parents[parents[one]]
        one = parents[one]
    return one


@kernel(cached=False)
def join_two(parents, one, other):
    """Make the sets of two members one."""
    one, other = root_of(parents, one), root_of(parents, other)
    if one < other:
        parents[other] = one
    else:
        parents[one] = other
