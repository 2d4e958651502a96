"""The CPU kernel: steps of all windows, on one thread or on all of them, in float32.

In a step, each thread first adds up the forces of the cells around its nodes, then nodes add those of their springs and
move (:mod:`heartcase.simulator.engine.cpu.steps`). Where elements share strain, it also writes the gradients of cells
and the stress of the means around nodes before the forces that need them; those that two threads need both of them
write, with the same bits. A window reads only what was written before the last barrier, or by its own thread
(:mod:`heartcase.simulator.engine.cpu.chunks`), and writes only its own lanes, so that the result does not depend on the
number of threads. Lanes without a cell it may read while another thread writes them, with a share of zero: how far a
NaN of a state that breaks down has come does depend on threads.

Where springs act alone, corners that are about to turn inside out are looked for in the first step and every LOOK_STEPS
from there, or in every step while there are probes; in between, only the windows that had such corners are looked
after. Where cells are worked out, each looks
after its own in every step. Where tissue may sleep
(:mod:`heartcase.simulator.engine.cpu.sleep`), only windows that are awake are worked out.
"""

from __future__ import annotations

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Float32, Int8, Int32, Int64
from heartcase.simulator.engine.cpu.arrays import (
    CellArrays,
    CellWork,
    InstrumentArrays,
    NodeArrays,
    SharingArrays,
    StepRow,
    ThreadPlace,
)
from heartcase.simulator.engine.cpu.barrier import raise_to, wait_at
from heartcase.simulator.engine.cpu.cells import (
    FLAT,
    PRESSED,
    clear_window,
    element_of_window,
    gradient_of_window,
    guard_of_window,
    is_flat_window,
    mean_stress_of_window,
    mean_stress_of_window_with_more,
    sharing_element_of_window,
    volume_of_window,
)
from heartcase.simulator.engine.cpu.chunks import SHARES, ChunkArrays, part_of, share_out
from heartcase.simulator.engine.cpu.ghosts import (
    add_ghost_forces,
    clear_ghost_forces,
    follow_movements,
    follow_nodes,
    share_with_ghosts,
    sum_of_ghosts,
)
from heartcase.simulator.engine.cpu.instruments import Constants, pull_explicitly
from heartcase.simulator.engine.cpu.sleep import (
    CHECK_STEPS,
    PULLED,
    ROUSE_STEPS,
    SleepArrays,
    check,
    feel_probes,
    remember,
    rouse,
    settle,
)
from heartcase.simulator.engine.cpu.springs import force_of_window, force_of_window_with_cells, tension_of_window
from heartcase.simulator.engine.cpu.steps import (
    step_of_windows,
    step_of_windows_from_both_ends,
    step_of_windows_with_cells,
    step_of_windows_with_cells_alone,
    step_of_windows_with_cells_from_both_ends,
)
from heartcase.simulator.engine.cpu.tethers import keep_both_ends_awake, pull_by_tethers, stretch_tethers
from heartcase.simulator.engine.cpu.turning import allow_cells, look_at_cells, push_out, shorten
from heartcase.simulator.engine.cpu.vector_ir import flush_subnormals, restore_subnormals
from heartcase.simulator.engine.shared.lanes import BANK_LANES, CELL_NUMBERS
from heartcase.simulator.lattice.moduli import LOOK_STEPS

__all__ = [
    "CHUNKS_PER_ROOM",
    "ELEMENTS",
    "NO_CELLS",
    "SHARING_ELEMENTS",
    "VOLUME_TERM",
    "advance",
    "lane_forces",
]

StateArrays = tuple[Float32, Float32, Float32, Float32, Float32, Float32, Float32, Int64]

CELLS_AT_ONCE = 64
"""Windows of cells that share strain whose gradients, means and forces are worked out one after the other."""
CHUNKS_PER_ROOM = CELL_NUMBERS // 3
"""Chunks whose forces share an array: it has room for so many numbers a lane."""
NO_CELLS, VOLUME_TERM, ELEMENTS, SHARING_ELEMENTS = 0, 1, 2, 3
"""What acts in the cells beside springs and the corner guard."""


@kernel
def _look_at_share(share: int, now: Float32, cells: CellArrays, sleep: SleepArrays) -> None:
    """Mark the windows of cells that have a corner to be looked after."""
    awake, counts = sleep.awake_cells, sleep.counts
    first, end = part_of(share, counts[1])
    for window in awake[first:end]:
        cells.is_flat[window] = is_flat_window(now, cells.numbers, cells.rows, window, cells.in_pairs[window])


@kernel
def _mark_touched(cells: CellArrays) -> None:
    """Mark the windows of nodes to which flat cells belong."""
    cells.is_touched[:] = 0
    for window in range(len(cells.rows)):
        if cells.is_flat[window]:
            for touched in cells.touches[window]:
                if touched >= 0:
                    cells.is_touched[touched] = 1


@kernel
def _has_flat(cells: CellArrays) -> bool:
    return bool(cells.is_flat.any())


@kernel
def _stretch(windows: Int64 | Int32, now: Float32, cells: CellArrays, sharing: SharingArrays) -> None:
    """Write the gradients of those of some windows of cells that share strain."""
    for place in range(len(windows)):
        window = np.int64(windows[place])
        if sharing.is_sharing[window]:
            gradient_of_window(now, cells.numbers, sharing.gradient, cells.rows, window, cells.in_pairs[window])


@kernel
def _share_strain(windows: Int32, rows: Int64, work: CellWork) -> None:
    """Write the stress of the means around the nodes of some windows."""
    cells, _, sharing, ghosts = work
    _, node_shares, ghost_shares, sums, gradient, stress, _ = sharing
    # One after the other: a vector that is loaded soon after its numbers were stored one by one has to wait.
    for window in windows:
        if ghosts.window_number[window] >= 0:
            sum_of_ghosts(window, rows[window, 4], gradient, ghost_shares, sums, ghosts)
    for window in windows:
        place = np.int64(window)
        number = ghosts.window_number[place]
        if number < 0:
            mean_stress_of_window(gradient, node_shares, sums, stress, cells.law, rows, place, number)
        else:
            mean_stress_of_window_with_more(gradient, node_shares, sums, stress, cells.law, rows, place, number)
    for window in windows:
        if ghosts.window_number[window] >= 0:
            share_with_ghosts(window, stress, ghosts)


@kernel
def _add_cells(windows: Int64 | Int32, now: Float32, force: Float32, work: CellWork) -> None:
    """Add the forces of some windows of cells to those on the nodes."""
    cells, (kind, _, has_guard), sharing, ghosts = work
    rows, numbers, law, is_flat = cells.rows, cells.numbers, cells.law, cells.is_flat
    for place in range(len(windows)):
        window = np.int64(windows[place])
        in_pairs = cells.in_pairs[window]
        if kind == NO_CELLS and not is_flat[window]:
            continue
        if window >= ghosts.first_window:
            clear_ghost_forces(force, window, ghosts)
        if kind == SHARING_ELEMENTS and sharing.is_sharing[window]:
            seen = sharing_element_of_window(
                now, numbers, sharing.shares, sharing.stress, force, law, rows, window, in_pairs
            )
        elif kind >= ELEMENTS:
            seen = element_of_window(now, numbers, force, law, rows, window, in_pairs)
        elif kind == VOLUME_TERM:
            seen = volume_of_window(now, numbers, force, law, rows, window, in_pairs)
        else:
            # between two looks a corner may have come below the floor
            seen = PRESSED | FLAT
        is_flat[window] = seen & FLAT
        if seen & PRESSED and has_guard:
            guard_of_window(now, numbers, force, law, rows, window, in_pairs)
        if window >= ghosts.first_window:
            add_ghost_forces(force, window, ghosts)


@kernel
def _add_sharing_cells(
    chunk: int, now: Float32, force: Float32, work: CellWork, rows: Int64, chunks: ChunkArrays
) -> None:
    """Add the forces of a chunk's cells that share strain, few at a time: what they read is still in the cache."""
    cells, means, strained = chunks.cells[chunk], chunks.means[chunk], chunks.strained[chunk]
    mean_count, strained_count, cell_count = np.int64(0), np.int64(0), chunks.cell_counts[chunk]
    for first in range(0, cell_count, CELLS_AT_ONCE):
        end = min(first + CELLS_AT_ONCE, cell_count)
        mean_end = chunks.mean_ends[chunk, end - 1]
        if mean_end > mean_count:
            strained_end = chunks.strained_ends[chunk, mean_end - 1]
            _stretch(strained[strained_count:strained_end], now, work.cells, work.sharing)
            _share_strain(means[mean_count:mean_end], rows, work)
            mean_count, strained_count = mean_end, strained_end
        _add_cells(cells[first:end], now, force, work)


@kernel
def _step_chunk(chunk: int, state: StateArrays, constants: Constants, chunks: ChunkArrays, sleep: SleepArrays) -> None:
    """Move the windows of a chunk, by springs alone."""
    now, later, velocity, weight, window_numbers, tension, inverse_mass, rows = state
    awake, before = sleep.awake, chunks.before
    first, end = chunks.ends[chunk], chunks.ends[chunk + 1]
    for number in range(chunks.before_counts[chunk]):
        tension_of_window(now, window_numbers, tension, rows, np.int64(before[chunk, number]))
    what = (
        now,
        later,
        velocity,
        weight,
        window_numbers,
        tension,
        velocity,
        inverse_mass,
        rows,
        awake,
        first,
        end,
        constants,
    )
    if len(tension):
        step_of_windows(*what)
    else:
        step_of_windows_from_both_ends(*what)


@kernel
def _step_chunk_with_cells(
    chunk: int,
    state: StateArrays,
    constants: Constants,
    work: CellWork,
    chunks: ChunkArrays,
    sleep: SleepArrays,
) -> None:
    """Move the windows of a chunk, by cells and springs."""
    cells, (kind, has_springs, _), _, _ = work
    now, later, velocity, weight, window_numbers, tension, inverse_mass, rows = state
    is_touched = cells.is_touched
    force = cells.force[chunk // CHUNKS_PER_ROOM, 3 * BANK_LANES * (chunk % CHUNKS_PER_ROOM) :]
    awake, before = sleep.awake, chunks.before
    first, end = chunks.ends[chunk], chunks.ends[chunk + 1]
    for window in awake[first:end]:
        if kind != NO_CELLS or is_touched[window]:
            clear_window(force, rows, window)
    if kind == SHARING_ELEMENTS:
        _add_sharing_cells(chunk, now, force, work, rows, chunks)
    else:
        _add_cells(chunks.cells[chunk, : chunks.cell_counts[chunk]], now, force, work)
    if has_springs:
        for number in range(chunks.before_counts[chunk]):
            tension_of_window(now, window_numbers, tension, rows, np.int64(before[chunk, number]))
    arrays = (now, later, velocity, weight, window_numbers, tension, force, inverse_mass, rows)
    keeps_tensions = len(tension) > 0
    while first < end:
        # As many as follow each other that are alike: all, but where only corners are guarded.
        has_cells = kind != NO_CELLS or is_touched[awake[first]] > 0
        stop = end if kind != NO_CELLS else first + 1
        while stop < end and (is_touched[awake[stop]] > 0) == has_cells:
            stop += 1
        what = (*arrays, awake, first, stop, constants)
        if not has_springs:
            step_of_windows_with_cells_alone(*what)
        elif has_cells and keeps_tensions:
            step_of_windows_with_cells(*what)
        elif has_cells:
            step_of_windows_with_cells_from_both_ends(*what)
        elif keeps_tensions:
            step_of_windows(*what)
        else:
            step_of_windows_from_both_ends(*what)
        first = stop


@kernel
def lane_forces(
    displacement: Float32,
    weight: Float32,
    force: Float32,
    rows: Int64,
    work: CellWork,
    nodes: Int64,
    sleep: SleepArrays,
    chunks: ChunkArrays,
) -> None:
    """Write the forces [grid units] on some windows, of displacements [cells]; three numbers a lane each.

    ``rows`` are those of these windows, ``nodes`` those of all.
    """
    cells, (kind, _, has_guard), sharing, ghosts = work
    if rouse(sleep, True):
        share_out(chunks, sleep)
    follow_nodes(0, 1, displacement, ghosts)
    if has_guard and kind == NO_CELLS:
        for share in range(SHARES):
            _look_at_share(share, displacement, cells, sleep)
        _mark_touched(cells)
    if kind != NO_CELLS or has_guard:
        cell_force = cells.force[0]
        for window in range(rows.shape[0]):
            clear_window(cell_force, rows, window)
        if kind == SHARING_ELEMENTS:
            _stretch(sleep.awake_cells, displacement, cells, sharing)
            _share_strain(chunks.corners[: chunks.corner_counts[0]], nodes, work)
        _add_cells(sleep.awake_cells, displacement, cell_force, work)
        for window in range(rows.shape[0]):
            force_of_window_with_cells(displacement, weight, cell_force, force, rows, window)
    else:
        for window in range(rows.shape[0]):
            force_of_window(displacement, weight, force, force, rows, window)


@kernel
def _check_share(
    share: int,
    displacement: Float32,
    velocity: Float32,
    inverse_mass: Float32,
    rows: Int64,
    rest: Float32,
    probes: Float32,
    step_number: int,
    sleep: SleepArrays,
    still: Float32,
    is_near: Int8,
) -> None:
    """Look for what moves, or soon will, in a share of the windows of nodes; what a probe pushes does not rest."""
    first, end = part_of(share, sleep.counts[0])
    check(first, end, rows, displacement, velocity, inverse_mass, still, sleep)
    if len(probes):
        first, end = part_of(share, len(rows))
        feel_probes(first, end, rows, displacement, rest, probes, step_number, sleep)
        for window in range(first, end):
            if is_near[window] > 1:
                for block in sleep.blocks_of_window[window]:
                    raise_to(sleep.is_moving, block, PULLED)


@kernel
def _keep_from_turning(
    now: Float32,
    later: Float32,
    nodes: NodeArrays,
    work: CellWork,
    instruments: InstrumentArrays,
    step_number: int,
    step: np.float32,
    sleep: SleepArrays,
    touched_ends: Int32,
    place: ThreadPlace,
) -> None:
    """Push nodes out of the probes after a step, and keep corners from turning."""
    cells, kinds, _, ghosts = work
    _, probes, turn, given, _ = instruments
    velocity, inverse_mass, rest, rows = nodes.velocity, nodes.inverse_mass, nodes.rest, nodes.rows
    thread, thread_count, barrier = place
    looks_after_flat = kinds[2] and (kinds[0] != NO_CELLS or len(probes) > 0)
    if len(probes):
        push_out(
            thread,
            thread_count,
            now,
            later,
            velocity,
            inverse_mass,
            rest,
            rows,
            sleep.is_asleep,
            probes,
            step_number,
            step,
            turn,
            given,
        )
        wait_at(barrier, thread_count)
    if len(ghosts.lane):
        follow_nodes(thread, thread_count, now, ghosts)
        follow_movements(thread, thread_count, later, turn.near, ghosts)
        wait_at(barrier, thread_count)
    look_at_cells(
        thread,
        thread_count,
        now,
        later,
        cells.rows,
        cells.numbers,
        cells.touches,
        touched_ends,
        cells.in_pairs,
        cells.is_flat,
        looks_after_flat,
        len(probes) > 0,
        step_number,
        turn,
    )
    wait_at(barrier, thread_count)
    if not turn.harm[0]:
        return
    how = (inverse_mass, cells.rows, cells.numbers, looks_after_flat)
    allow_cells(thread, thread_count, now, later, *how, turn)
    wait_at(barrier, thread_count)
    nodes_now = (now, later, velocity, inverse_mass, rest, rows)
    shorten(thread, thread_count, *nodes_now, probes, step_number, turn, given, ghosts)
    wait_at(barrier, thread_count)
    if thread == 0:
        turn.harm[0] = 0


@kernel
def advance(
    nodes: NodeArrays,
    work: CellWork,
    instruments: InstrumentArrays,
    steps: StepRow,
    sleep: SleepArrays,
    chunks: ChunkArrays,
    place: ThreadPlace,
) -> int:
    """Take steps in place, as one of some threads that all call it.

    Arrays with several numbers a lane have them BANK_LANES apart
    (:class:`heartcase.simulator.engine.shared.lanes.LaneLayout`).

    Parameters
    ----------
    nodes
        Nodes and their springs.
    work
        What is done in the cells.
    instruments
        Explicit springs, probes and stitches.
    steps
        The steps to take.
    sleep
        As of :func:`heartcase.simulator.engine.cpu.sleep.sleep_arrays`.
    chunks
        As of :func:`heartcase.simulator.engine.cpu.chunks.chunk_arrays`.
    place
        Which of the threads this is.

    Returns
    -------
    int
        Buffer that holds the displacement at the end.
    """
    displacement, velocity, weight, window_numbers, tension, inverse_mass, rows, rest = nodes
    cells, (kind, _, has_guard), _, ghosts = work
    explicit, probes, turn, _, tethers = instruments
    current, step_count, first_step, first_constants, other_constants, last_constants, has_last, still = steps
    thread, thread_count, barrier = place
    chunk_count = len(chunks.before_counts)
    works_cells = kind != NO_CELLS or _has_flat(cells)
    # Nobody changes anything before all are there.
    if not wait_at(barrier, thread_count):
        return current
    before = flush_subnormals()
    for step_number in range(step_count + has_last):
        constants = other_constants if step_number else first_constants
        if step_number == step_count:
            constants = last_constants
        now = displacement[3 * BANK_LANES * current :]
        later = displacement[3 * BANK_LANES * (1 - current) :]
        row_step = first_step + step_number
        if row_step % ROUSE_STEPS == 0:
            if thread == 0 and rouse(sleep, row_step == 0):
                share_out(chunks, sleep)
            wait_at(barrier, thread_count)
        is_checked = still[0] > 0 and row_step % CHECK_STEPS == 0 and step_number < step_count
        if is_checked:
            for share in range(thread, SHARES, thread_count):
                first, end = part_of(share, sleep.counts[0])
                remember(first, end, rows, velocity, sleep)
            wait_at(barrier, thread_count)
        is_looked_at = has_guard and kind == NO_CELLS and (row_step % LOOK_STEPS == 0 or len(probes) > 0)
        if len(ghosts.lane) and (works_cells or is_looked_at):
            follow_nodes(thread, thread_count, now, ghosts)
            wait_at(barrier, thread_count)
        if is_looked_at:
            for share in range(thread, SHARES, thread_count):
                _look_at_share(share, now, cells, sleep)
            wait_at(barrier, thread_count)
            works_cells = _has_flat(cells)
            if works_cells:
                if thread == 0:
                    _mark_touched(cells)
                wait_at(barrier, thread_count)
        if len(tethers.lanes):
            stretch_tethers(thread, thread_count, now, row_step, tethers)
            wait_at(barrier, thread_count)
        state = (now, later, velocity, weight, window_numbers, tension, inverse_mass, rows)
        for chunk in range(thread, chunk_count, thread_count):
            pull_by_tethers(chunk, velocity, inverse_mass, tethers, constants, chunks)
            pull_explicitly(chunk, now, velocity, inverse_mass, explicit, constants, chunks)
            if works_cells:
                _step_chunk_with_cells(chunk, state, constants, work, chunks, sleep)
            else:
                _step_chunk(chunk, state, constants, chunks, sleep)
        wait_at(barrier, thread_count)
        if len(probes) > 0 and step_number < step_count:
            _keep_from_turning(
                now, later, nodes, work, instruments, row_step, constants[0], sleep, chunks.touched_ends, place
            )
        current = 1 - current
        if is_checked:
            for share in range(thread, SHARES, thread_count):
                _check_share(
                    share, later, velocity, inverse_mass, rows, rest, probes, row_step + 1, sleep, still, turn.is_near
                )
            wait_at(barrier, thread_count)
            if thread == 0:
                keep_both_ends_awake(tethers, sleep)
                if settle(later, now, velocity, rows, cells.touches, sleep):
                    share_out(chunks, sleep)
            wait_at(barrier, thread_count)
    restore_subnormals(before)
    return current
