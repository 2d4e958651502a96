"""Disjoint sets for kernels: each is a tree of links to a parent, whose root names it.

Tarjan and van Leeuwen, Worst-case analysis of set union algorithms, Journal of the ACM 31 (1984), with path halving.
"""

from __future__ import annotations

from heartcase.compiling.calls import copied

__all__ = ["root_of"]


@copied
def root_of(parent, member):
    """Root of a member's set, itself its own parent; links on the way are shortened."""
    while parent[member] != member:
        parent[member] = parent[parent[member]]
        member = parent[member]
    return member
