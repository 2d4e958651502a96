"""Places of cells that a sheet comes to, and those around them, by their keys: kernels."""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel

__all__ = [
    "begun_among",
    "found_among",
    "mark",
    "merged",
    "next_places",
    "places_around",
    "places_of_links",
    "samples_of_places",
    "taken_over",
    "tissue_bits",
]

_ROOM = 1 << 20
"""What is added to an index in its part of a key, of 21 bits."""
_FIELD = (1 << 21) - 1


@kernel(cached=False)
def place_of(link):
    """Key of the place that a link's lower sample lies in."""
    moved = _ROOM - (_ROOM >> 3)
    i, j, k = ((link & _FIELD) >> 3) + moved, ((link >> 21 & _FIELD) >> 3) + moved, (link >> 45) + moved
    return (k << 42) | (j << 21) | i


@kernel(cached=False)
def _insert(table, key):
    """Whether a key was not yet in a table of a power of two, of which half is free; -1 is no key."""
    mask = len(table) - 1
    at = (key ^ (key >> 19) ^ (key >> 37)) * 0x61C8864680B583 >> 20 & mask
    while table[at] != -1:
        if table[at] == key:
            return False
        at = (at + 1) & mask
    table[at] = key
    return True


@kernel(cached=False)
def _table_for(count):
    size = 16
    while size < 2 * count + 2:
        size *= 2
    return np.full(size, -1, np.int64)


@kernel
def places_of_links(x, y, z):
    """Keys of the places that a link along x, y or z begins or ends in, ascending."""
    total = len(x) + len(y) + len(z)
    table, found, count = _table_for(2 * total), np.empty(2 * total, np.int64), 0
    for axis, links in enumerate((x, y, z)):
        last = -1
        for link in links:
            for end in (link, link + (1 << 21 * axis)):
                key = place_of(end)
                if key != last and _insert(table, key):
                    found[count] = key
                    count += 1
                last = key
    return np.sort(found[:count])


@kernel
def places_around(keys):
    """Keys of places and the 26 around each, ascending."""
    table, found, count = _table_for(27 * len(keys)), np.empty(27 * len(keys), np.int64), 0
    for key in keys:
        for k in range(-1, 2):
            for j in range(-1, 2):
                for i in range(-1, 2):
                    there = key + (k << 42) + (j << 21) + i
                    if _insert(table, there):
                        found[count] = there
                        count += 1
    return np.sort(found[:count])


@kernel(cached=False)
def find(keys, key):
    """Place of a key among some, ascending, or -1."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else -1


@kernel
def found_among(keys, listed):
    """Place of each key among those listed, ascending, or -1; int64, shape (count,)."""
    places = np.empty(len(keys), np.int64)
    for number in range(len(keys)):
        places[number] = find(listed, keys[number])
    return places


@kernel
def merged(known, more):
    """Numbers of either list, both ascending, once, ascending, and the place of each in both, or -1."""
    both = np.empty(len(known) + len(more), np.int64)
    of_known, of_more = np.empty(len(both), np.int64), np.empty(len(both), np.int64)
    count, a, b = 0, 0, 0
    while a < len(known) or b < len(more):
        takes_known = a < len(known) and (b == len(more) or known[a] <= more[b])
        takes_more = b < len(more) and (a == len(known) or more[b] <= known[a])
        both[count] = known[a] if takes_known else more[b]
        of_known[count] = a if takes_known else -1
        of_more[count] = b if takes_more else -1
        a += takes_known
        b += takes_more
        count += 1
    return both[:count], of_known[:count], of_more[:count]


@kernel
def mark(keys, x, y, z, marks):
    """Mark links along x, y and z that begin in some places; shape (count, 3, 8), written."""
    for axis, links in enumerate((x, y, z)):
        last, row = -1, -1
        for link in links:
            key = place_of(link)
            if key != last:
                last, row = key, find(keys, key)
            if row >= 0:
                marks[row, axis, link >> 42 & 7] |= 1 << ((link & 7) + 8 * (link >> 21 & 7))


@kernel
def begun_among(places, links):
    """Links that begin in some places, whose keys are given, ascending; in their order."""
    found, count, last, is_in = np.empty(len(links), np.int64), 0, -1, False
    for link in links:
        key = place_of(link)
        if key != last:
            last, is_in = key, find(places, key) >= 0
        if is_in:
            found[count] = link
            count += 1
    return found[:count].copy()


@kernel
def samples_of_places(keys):
    """First and last index (i, j, k) of the samples of all of some places, shape (3,)."""
    low, high = np.full(3, _ROOM), np.full(3, -_ROOM)
    for key in keys:
        for axis in range(3):
            at = (key >> 21 * axis & _FIELD) - _ROOM
            low[axis], high[axis] = min(low[axis], 8 * at), max(high[axis], 8 * at + 7)
    return low, high


@kernel
def next_places(keys):
    """Place of the next key along each axis among some, ascending, or -1; shape (count, 3)."""
    there = np.empty((len(keys), 3), np.int64)
    for axis in range(3):
        step, at = 1 << 21 * axis, 0
        for number in range(len(keys)):
            wanted = keys[number] + step
            while at < len(keys) and keys[at] < wanted:
                at += 1
            there[number, axis] = at if at < len(keys) and keys[at] == wanted else -1
    return there


@kernel
def tissue_bits(entries, cells, bits):
    """Write which samples of some cells lie in the tissue, shape (count, 8).

    A sample is inside where the surface was crossed an odd number of times on its row before it.

    Parameters
    ----------
    entries
        Keys of the links along x that the surface crosses, ascending.
    cells
        Index (i, j, k) of each cell, shape (count, 3).
    bits
        Written.
    """
    for number in range(len(cells)):
        i, j, k = np.int64(cells[number, 0]), np.int64(cells[number, 1]), np.int64(cells[number, 2])
        for layer in range(8):
            start = ((8 * k + layer + _ROOM) << 42) | ((8 * j + _ROOM) << 21)
            at = np.searchsorted(entries, start)
            samples = 0
            for row in range(8):
                end, key = start + (1 << 21), start + 8 * i + _ROOM
                inside = 0
                while at < len(entries) and entries[at] < key:
                    inside ^= 1
                    at += 1
                line = 0
                for sample in range(8):
                    while at < len(entries) and entries[at] < key + sample:
                        inside ^= 1
                        at += 1
                    line |= inside << sample
                samples |= line << 8 * row
                while at < len(entries) and entries[at] < end:
                    at += 1
                start = end
            bits[number, layer] = samples


@kernel
def taken_over(rows, of_known):
    """Rows of numbers that are known, and zeros where there are none (-1); shape (count, row length)."""
    found = np.zeros((len(of_known), rows.shape[1]), np.int64)
    for number in range(len(of_known)):
        if of_known[number] >= 0:
            found[number] = rows[of_known[number]]
    return found
