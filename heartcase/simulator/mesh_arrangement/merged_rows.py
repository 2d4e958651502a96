"""Rows of numbers put among others, each once and ascending: kernels."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = ["merge_rows", "number_rows", "order_rows"]


@kernel(cached=False)
def _compared(one, other):
    """Below, at or above 0 as the first of two rows comes before the second, is it, or comes after it."""
    for column in range(len(one)):
        if one[column] != other[column]:
            return -1 if one[column] < other[column] else 1
    return 0


@kernel
def order_rows(rows):
    """Order in which rows ascend, those that are the same in their order, shape (count,)."""
    count = len(rows)
    order, spare = np.arange(count), np.empty(count, np.int64)
    width = 1
    while width < count:
        for start in range(0, count, 2 * width):
            middle, stop = min(start + width, count), min(start + 2 * width, count)
            one, other = start, middle
            for at in range(start, stop):
                if other >= stop or (one < middle and _compared(rows[order[one]], rows[order[other]]) <= 0):
                    spare[at] = order[one]
                    one += 1
                else:
                    spare[at] = order[other]
                    other += 1
        order, spare = spare, order
        width *= 2
    return order


@kernel
def merge_rows(old, new, old_number, new_number, source):
    """Number rows that ascend, each once, together with others; returns how many there are.

    Parameters
    ----------
    old
        Rows, each once and ascending, int64, shape (old_count, any).
    new
        More rows, in any order and any number of times, shape (new_count, any).
    old_number, new_number
        Number of each, shapes (old_count,) and (new_count,); written.
    source
        For each number the old row, or -1 less the first new row, shape (old_count + new_count,); written.
    """
    order = order_rows(new)
    count, at = 0, 0
    for row in range(len(old) + 1):
        while at < len(order) and (row == len(old) or _compared(new[order[at]], old[row]) < 0):
            is_first = at == 0 or _compared(new[order[at]], new[order[at - 1]]) != 0
            if is_first:
                source[count] = -1 - order[at]
                count += 1
            new_number[order[at]] = count - 1
            at += 1
        if row == len(old):
            break
        source[count], old_number[row] = row, count
        count += 1
        while at < len(order) and _compared(new[order[at]], old[row]) == 0:
            new_number[order[at]] = count - 1
            at += 1
    return count


@kernel
def number_rows(rows):
    """Number of each row among all that differ, ascending, shape (count,)."""
    order, numbers = order_rows(rows), np.empty(len(rows), np.int64)
    count = 0
    for at in range(len(order)):
        if at > 0 and _compared(rows[order[at]], rows[order[at - 1]]) != 0:
            count += 1
        numbers[order[at]] = count
    return numbers
