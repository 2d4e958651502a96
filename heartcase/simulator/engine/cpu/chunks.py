"""Division of the windows among threads; each spring is worked out once.

Both ends of a spring need its tension. A window works out those of the nine springs ahead of each lane and keeps them;
for the springs behind, it finds them where earlier windows left them. A thread takes a chunk of windows that follow
each other, and before it those behind them that are not in it, or are asleep: of these it works out the tensions alone.
So no thread waits for another, and what two of them both work out is the same to the bit. It is alike with cells: a
thread works out all that its windows are corners of, and adds up their forces for itself, always in the same order.
Where cells share strain, it also works out the means around all their corners, and the gradients of all cells that
these are means of.

Lattices that no cache holds take longer to keep and fetch tensions than to work them out from both ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import get_num_threads

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Int8, Int32, Int64
from heartcase.simulator.engine.cpu.sleep import SleepArrays
from heartcase.simulator.engine.shared.lane_kernels import list_windows, ranges_behind, write_behind
from heartcase.simulator.engine.shared.lanes import LaneLayout
from heartcase.simulator.lattice.model import DIRECTIONS

__all__ = ["KEPT_NODES_MAX", "SHARES", "ChunkArrays", "behind_windows", "chunk_arrays", "part_of", "share_out"]


KEPT_NODES_MAX = 120_000
"""Nodes up to which tensions are kept. On a processor with 32 MB of cache that others use, too, to keep them took 0.63
to 0.85 of the time at 60,000 and 100,000 nodes, and as long as both ends at 250,000."""
_LAYERS_MIN = 2
"""Layers of windows in a chunk: with fewer, threads would work out more tensions for others than for themselves."""


SHARES = 64
"""Parts of the windows that threads take in turn, where nothing is worked out for others."""


@kernel
def part_of(share: int, count: int) -> tuple[int, int]:
    """The first of so many windows in a share, and that behind its last."""
    return share * count // SHARES, (share + 1) * count // SHARES


class ChunkArrays(NamedTuple):
    """The windows of each chunk."""

    behind: Int32
    """Windows with the other ends of the springs behind each window's lanes, then -1, shape (window_count, any)."""
    ends: Int64
    """Where each chunk begins, and the last ends, in the list of windows that are awake, shape (chunk_count + 1,)."""
    before: Int32
    """Windows of which a chunk needs the tensions alone come first, shape (chunk_count, window_count)."""
    before_counts: Int64
    """How many these are, shape (chunk_count,)."""
    taken_by: Int32
    """Room for the last chunk that a window was counted to, shape (window_count,)."""
    chunk_of: Int32
    """Chunk that steps each window, -1 for those that sleep, shape (window_count,)."""
    touches: Int64
    """Windows of nodes that the cells of a window have corners in, then -1, shape (cell_window_count, any)."""
    touched_ends: Int32
    """The lowest and the highest of these, shape (cell_window_count, 2)."""
    cells: Int32
    """Windows of cells that have a corner in a chunk come first, shape (chunk_count, cell_window_count)."""
    cell_counts: Int64
    """How many these are, shape (chunk_count,)."""
    corners: Int32
    """Windows of nodes that are corners of the windows of cells that are awake come first, shape (window_count,)."""
    corner_counts: Int64
    """How many these are, shape (1,)."""
    shares_strain: Int8
    """Whether cells share strain, shape (1,): only then are the lists that follow made."""
    means: Int32
    """Windows of nodes that the cells of a chunk end at come first, ascending, shape (chunk_count, window_count)."""
    strained: Int32
    """Windows of cells around these come first, shape (chunk_count, cell_window_count)."""
    mean_ends: Int64
    """How many of the means must be known for each of a chunk's windows of cells and those before it, shape
    (chunk_count, cell_window_count)."""
    strained_ends: Int64
    """How many of the gradients must be known for each of the means and those before it, shape (chunk_count,
    window_count)."""
    ghost_window: Int64
    """First window of cells that holds ghosts, shape (1,)."""


def chunk_arrays(behind: Int32, touches: Int64, sleep: SleepArrays, layer_count: int, ghost_window: int) -> ChunkArrays:
    """Share out the windows of a layout to as many chunks as there are threads, if its layers are enough."""
    chunk_count = max(1, min(get_num_threads(), layer_count // _LAYERS_MIN))
    window_count = len(behind)
    lowest = touches.min(axis=1, initial=window_count, where=touches >= 0)
    chunks = ChunkArrays(
        behind,
        np.zeros(chunk_count + 1, np.int64),
        np.zeros((chunk_count, window_count), np.int32),
        np.zeros(chunk_count, np.int64),
        np.zeros(window_count, np.int32),
        np.zeros(window_count, np.int32),
        touches,
        np.stack([lowest, touches.max(axis=1, initial=-1)], axis=1).astype(np.int32),
        np.zeros((chunk_count, len(touches)), np.int32),
        np.zeros(chunk_count, np.int64),
        np.zeros(window_count, np.int32),
        np.zeros(1, np.int64),
        np.zeros(1, np.int8),
        np.zeros((chunk_count, window_count), np.int32),
        np.zeros((chunk_count, len(touches)), np.int32),
        np.zeros((chunk_count, len(touches)), np.int64),
        np.zeros((chunk_count, window_count), np.int64),
        np.array([ghost_window]),
    )
    share_out(chunks, sleep)
    return chunks


def behind_windows(layout: LaneLayout) -> Int32:
    """Windows with the other ends of the springs behind each window's lanes, then -1, shape (window_count, any)."""
    window_count = layout.window_count
    ranges = np.empty((len(DIRECTIONS) * window_count, 3), np.int64)
    ranges = ranges[: ranges_behind(layout.window_rows, DIRECTIONS, ranges)]
    # The lanes behind a window along a direction lie in two windows at most.
    lists, firsts = np.empty(2 * len(DIRECTIONS) * window_count, np.int32), np.empty(window_count + 1, np.int64)
    longest = list_windows(ranges, *layout.windows_by_lanes, lists, firsts)
    # Each has its own window in it: a spring along i leads back to the lane before.
    behind = np.empty((window_count, max(1, longest - 1)), np.int32)
    write_behind(lists, firsts, behind)
    return behind


@kernel
def _set_ends(ends: Int64, before_counts: Int64, count: int) -> None:
    """Share out so many windows, where a window of which the tensions alone are needed is half as much work."""
    chunk_count = len(before_counts)
    work = 2 * count + before_counts.sum()
    spent = 0
    for chunk in range(chunk_count):
        spent += before_counts[chunk]
        end = ((chunk + 1) * work // chunk_count - spent) // 2
        ends[chunk + 1] = max(ends[chunk], min(end, count))
    ends[chunk_count] = count


@kernel
def share_out(chunks: ChunkArrays, sleep: SleepArrays) -> None:
    """Make the chunks from the windows that are awake."""
    behind, ends, before, before_counts = chunks.behind, chunks.ends, chunks.before, chunks.before_counts
    taken_by, chunk_of, touches = chunks.taken_by, chunks.chunk_of, chunks.touches
    cells, cell_counts = chunks.cells, chunks.cell_counts
    awake, awake_cells, is_asleep, count = sleep.awake, sleep.awake_cells, sleep.is_asleep, sleep.counts[0]
    chunk_count = len(before_counts)
    before_counts[:] = 0
    # Once to see how many windows each chunk needs the tensions of, then again so that these are shared out, too.
    for _ in range(2):
        _set_ends(ends, before_counts, count)
        taken_by[:] = -1
        for chunk in range(chunk_count):
            first, end = ends[chunk], ends[chunk + 1]
            before_counts[chunk] = 0
            if first == end:
                continue
            lowest = awake[first]
            for number in range(first, end):
                own = awake[np.uint64(number)]
                for place in range(behind.shape[1]):
                    window = behind[np.uint64(own), np.uint64(place)]
                    if window < 0:
                        break
                    # Windows behind come earlier: from the chunk's first on, those that are awake are its own.
                    is_in_chunk = window >= lowest and not is_asleep[np.uint64(window)]
                    if not is_in_chunk and taken_by[np.uint64(window)] != chunk:
                        taken_by[window] = chunk
                        before[chunk, before_counts[chunk]] = window
                        before_counts[chunk] += 1
    chunk_of[:] = -1
    cell_counts[:] = 0
    for chunk in range(chunk_count):
        for number in range(ends[chunk], ends[chunk + 1]):
            chunk_of[awake[number]] = chunk
    for number in range(sleep.counts[1]):
        window = awake_cells[np.uint64(number)]
        for place in range(touches.shape[1]):
            touched = touches[np.uint64(window), np.uint64(place)]
            if touched < 0:
                break
            chunk = chunk_of[np.uint64(touched)]
            if chunk < 0:
                continue
            last = cell_counts[np.uint64(chunk)] - 1
            if last < 0 or cells[np.uint64(chunk), np.uint64(last)] != window:
                cells[chunk, last + 1] = window
                cell_counts[chunk] += 1
    _list_corners(chunks, sleep)
    if chunks.shares_strain[0]:
        taken_by[:] = 0
        for chunk in range(chunk_count):
            _list_means(chunk, chunks, sleep)


@kernel
def _list_means(chunk: int, chunks: ChunkArrays, sleep: SleepArrays) -> None:
    """List the means around the corners of a chunk's cells, and the gradients that these are of.

    Of ``chunks.taken_by``, all zero before and after, only what the chunk needs is touched: there may be many chunks.
    """
    touches, touched_ends, place_of = chunks.touches, chunks.touched_ends, chunks.taken_by
    cells, means = chunks.cells[chunk, : chunks.cell_counts[chunk]], chunks.means[chunk]
    lowest, highest = len(place_of), -1
    for window in cells:
        lowest, highest = min(lowest, touched_ends[window, 0]), max(highest, touched_ends[window, 1])
        for touched in touches[window]:
            if touched < 0:
                break
            place_of[touched] = 1
    mean_count = 0
    for window in range(lowest, highest + 1):
        if place_of[window]:
            means[mean_count] = window
            mean_count += 1
            place_of[window] = mean_count
    most = 0
    for place in range(len(cells)):
        most = max(most, place_of[touched_ends[cells[place], 1]])
        chunks.mean_ends[chunk, place] = most
    ends = chunks.strained_ends[chunk]
    ends[:mean_count] = 0
    count = 0
    awake_count, first_ghost = sleep.counts[1], sleep.counts[1]
    while first_ghost > 0 and sleep.awake_cells[first_ghost - 1] >= chunks.ghost_window[0]:
        first_ghost -= 1
    # Those of ghosts first: they lie last, and with one of them all would have to be known before the rest is begun.
    for turn in range(awake_count):
        window = sleep.awake_cells[(first_ghost + turn) % awake_count]
        if touched_ends[window, 1] < lowest or touched_ends[window, 0] > highest:
            continue
        is_around = False
        for touched in touches[window]:
            if touched < 0:
                break
            if place_of[touched]:
                ends[place_of[touched] - 1] = count + 1
                is_around = True
        if is_around:
            chunks.strained[chunk, count] = window
            count += 1
    for place in range(mean_count):
        ends[place] = max(ends[place], ends[max(place - 1, 0)])
        place_of[means[place]] = 0


@kernel
def _list_corners(chunks: ChunkArrays, sleep: SleepArrays) -> None:
    is_corner = chunks.taken_by
    is_corner[:] = 0
    for number in range(sleep.counts[1]):
        window = sleep.awake_cells[np.uint64(number)]
        for place in range(chunks.touches.shape[1]):
            touched = chunks.touches[np.uint64(window), np.uint64(place)]
            if touched < 0:
                break
            is_corner[np.uint64(touched)] = 1
    count = 0
    for window in range(len(is_corner)):
        if is_corner[window]:
            chunks.corners[count] = window
            count += 1
    chunks.corner_counts[0] = count
