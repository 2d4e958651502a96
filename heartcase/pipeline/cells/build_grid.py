"""The simulation grid: tissue as cubic cells of partial coverage (thesis 11.2.1), with the topology of the scan.

Cells are parallel to the scan's axes and start at the lower corner of the region of interest. A cell exists where at
least ``coverage_min`` of it is tissue; :mod:`heartcase.pipeline.cells` then adds and removes cells so that walls stay
closed, openings stay open and nothing hangs by an edge or a corner. Thickness, volume and Betti numbers of the result
are compared with the full resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from scipy.spatial import cKDTree

from heartcase.compiling.calls import called
from heartcase.compiling.kernel import kernel, loop_kernel
from heartcase.pipeline.cells.changes import Change, topology_changes
from heartcase.pipeline.cells.hinges import HingeRepairs, hanging_cells, mend_hinges
from heartcase.pipeline.cells.moments import cell_moments
from heartcase.pipeline.cells.passages import blocked_openings, open_passages
from heartcase.pipeline.cells.repair import CellState, Index, cell_coverage, close_leaks, find_leaks, join_tissue
from heartcase.pipeline.cells.sampling import (
    CellSamples,
    VoidPieces,
    cell_lattice,
    sample_cells,
    sample_factor,
    void_pieces,
)
from heartcase.pipeline.cells.supports import fixed_nodes, floating_pieces
from heartcase.pipeline.data import SimulationGrid, Structures
from heartcase.pipeline.fields.reader import FieldReader
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.kernels.topology import betti_numbers, components, distance_in_samples, piece_sizes
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy, note
from heartcase.schemas.arrays import Bool, Float32, Int32, UInt8
from heartcase.schemas.bundle.lattice import cell_nodes
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.resolved import GridByCellSize, GridByNodeCount, ResolvedGrid
from heartcase.schemas.recipe.settings import GridSettings, Pin

__all__ = ["DEFAULT_NODE_COUNT", "FACE_CORNERS", "build_grid", "resolve_grid"]


DEFAULT_NODE_COUNT = 30_000
"""Nodes to aim at when neither a cell edge nor a node count is asked for (thesis 11.2.1)."""

FACE_CORNERS: Int32 = np.array(
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]], dtype=np.int32
)
"""Corners of a cell's faces towards -i, +i, -j, +j, -k, +k, counter-clockwise seen from outside, shape (6, 4)."""

_MAX_SAMPLES = 1_500_000_000
_MAX_CELLS = 100_000_000
_NAMED_PLACES = 5
_SMALL_PLACES = 3
_LISTED_PLACES = 100
_COUNT_TOLERANCE = 0.02


def build_grid(structures: Structures, settings: GridSettings, *, pins: Sequence[Pin] = ()) -> SimulationGrid:
    """Turn the tissue into cells (thesis 11.2.1).

    Parameters
    ----------
    structures
        Distance fields of all structures, and the end markers.
    settings
        Cell edge or node count, least coverage, whether to repair the topology.
    pins
        Balls of tissue that are held fixed, world mm.

    Returns
    -------
    SimulationGrid
        ``quality`` compares volume and Betti numbers with the full resolution and lists where the topology differs;
        ``warnings`` name what differs, with positions.

    Raises
    ------
    StageError
        There is no tissue, the cells are too small or too large for it, a pin holds no tissue, or nothing is fixed.
    """
    if not any(value in structures.values for value in structures.table.tissue_values):
        raise StageError(
            "there is no tissue: mark a myocardium or give a cavity a wall_thickness_mm (too much walls.smoothing_mm "
            "loses thin tissue)",
            place="grid",
        )
    reader = FieldReader.of(structures)
    chosen = resolve_grid(settings)
    if isinstance(chosen, GridByCellSize):
        samples = _sample(reader, chosen.cell_mm)
    else:
        samples = _samples_for_count(reader, chosen)
    if not (samples.coverage >= settings.coverage_min).any():
        raise StageError("no cell holds enough tissue: make the cells smaller, or check the walls", place="grid")
    pieces = void_pieces(samples)
    (state, quality, warnings), thickness = side_by_side(
        lambda: _shape_cells(samples, pieces, settings, structures.table), lambda: _thickness_percentiles(samples)
    )

    tissue = state.tissue
    cells = np.ascontiguousarray(np.argwhere(tissue)[:, ::-1].astype(np.int32))
    coverage = cell_coverage(samples, state, settings.coverage_min)[tissue]
    nodes, corners = cell_nodes(cells)
    faces, face_label, face_cell = _boundary(samples, pieces, state, corners)
    fixed = fixed_nodes(structures, samples, tissue, nodes, corners, pins)
    warnings += floating_pieces(samples.geometry, tissue, corners, fixed)
    hanging = hanging_cells(tissue, corners, nodes, fixed)
    if hanging:
        warnings.append(CaseWarning(sentence("hanging-tissue", count=len(hanging), places=_places(samples, hanging))))
    fine_ml = _tissue_volume_mm3(samples) * 1e-3
    grid_ml = float(coverage.sum(dtype=np.float64)) * samples.cell_mm**3 * 1e-3
    quality = {
        "cell_mm": samples.cell_mm,
        "cell_count": len(cells),
        "node_count": len(nodes),
        "face_count": len(faces),
        "fixed_node_count": int(fixed.sum()),
        "samples_per_cell_edge": samples.factor,
        "tissue_volume_ml": fine_ml,
        "grid_volume_ml": grid_ml,
        "volume_error_percent": 100.0 * (grid_ml - fine_ml) / fine_ml,
        "thickness_cells": thickness,
        "hinges_left": len(hanging),
        **quality,
    }
    return SimulationGrid(
        geometry=samples.geometry,
        cells=cells,
        cell_coverage=coverage,
        cell_moments=cell_moments(samples, cells),
        cell_label=_labels_of_cells(samples.cell_label, tissue)[tissue],
        nodes=nodes,
        fixed=fixed,
        faces=faces,
        face_label=face_label,
        face_cell=face_cell,
        table=structures.table,
        quality=quality,
        warnings=tuple(warnings),
    )


def resolve_grid(settings: GridSettings) -> ResolvedGrid:
    """Settings with the node count filled in where they ask for neither a cell edge nor a node count.

    Resolved settings come back as they are.
    """
    if isinstance(settings, GridByCellSize | GridByNodeCount):
        return settings
    if settings.cell_mm is not None:
        return GridByCellSize.of(settings)
    return GridByNodeCount.of(settings, node_count=settings.node_count or DEFAULT_NODE_COUNT)


def _sample(reader: FieldReader, cell_mm: float, factor: int | None = None) -> CellSamples:
    lattice = cell_lattice(reader.structures.geometry, cell_mm)
    factor = factor or sample_factor(reader.structures.geometry, cell_mm)
    if np.prod(lattice.size) > _MAX_CELLS or np.prod(lattice.size) * factor**3 > _MAX_SAMPLES:
        raise StageError(
            f"cells of {cell_mm:.3g} mm are too small for this region: ask for a larger cell_mm or fewer nodes",
            place="grid",
        )
    return sample_cells(reader, lattice, factor)


def _samples_for_count(reader: FieldReader, settings: GridByNodeCount) -> CellSamples:
    """Solve for the cell edge with the fewest samples per cell, then correct it with as many as the grid takes."""
    wanted = settings.node_count
    volume = reader.structures.geometry
    region_mm3 = volume.voxel_volume_mm3 * float(np.prod(volume.size))
    cell_mm = (region_mm3 / (4.0 * wanted)) ** (1 / 3)
    coarse = True
    tried: list[tuple[float, float, CellSamples]] = []
    for _ in range(10):
        samples = _sample(reader, cell_mm, 2 if coarse else None)
        if not samples.coverage.any():
            raise StageError("there is no tissue in the region of interest: check walls and region", place="grid")
        count = _node_count(samples.coverage >= settings.coverage_min)
        gap = abs(count - wanted) / wanted
        is_final = samples.factor == sample_factor(volume, cell_mm)
        if is_final:
            tried.append((gap, cell_mm, samples))
        if is_final and gap <= _COUNT_TOLERANCE:
            break
        if gap <= _COUNT_TOLERANCE:
            coarse = False
            continue
        # 2.7: walls a few cells thick; the cells become about half as large at most, also where none is left
        cell_mm *= max(count / wanted, 1 / 8) ** (1 / 2.7)
    if not tried:
        return _sample(reader, cell_mm)
    return min(tried, key=lambda one: one[:2])[2]


def _node_count(tissue: Bool) -> int:
    padded = np.pad(tissue, 1)
    for axis in range(3):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        padded = padded[low] | padded[high]
    return int(np.count_nonzero(padded))


def _shape_cells(
    samples: CellSamples, pieces: VoidPieces, settings: GridSettings, table: LabelTable
) -> tuple[CellState, dict[str, Any], list[CaseWarning]]:
    """Choose the tissue cells, repair them, and compare their topology with the samples'."""
    blood_values = np.isin(np.arange(256), table.blood_values)
    state = CellState(samples.coverage >= settings.coverage_min, pieces.main.copy(), blood_values[pieces.main_label])
    state.is_blood &= pieces.main > 0
    fine_blood = samples.void & blood_values[samples.void_label]
    fine_tissue = samples.tissue
    blood_width = np.where(fine_blood, (2.0 * distance_in_samples(~fine_tissue) - 1.0) / samples.factor, 0.0)
    unrepaired = state.copy()
    warnings: list[CaseWarning] = []
    leaks_closed = joined = opened = cells_opened = 0
    hinges = HingeRepairs()
    if settings.repair:
        fine_pieces = components(fine_tissue, 26)[0]
        leaks_closed = close_leaks(samples, pieces, state)
        before = len(state.added)
        join_tissue(samples, state, fine_pieces)
        opened = open_passages(samples, pieces, state, blood_width)
        stranded = join_tissue(samples, state, fine_pieces)
        joined = len(state.added) - before
        cells_opened = len(state.removed)
        hinges = mend_hinges(samples, pieces, state, fine_pieces)
        if stranded:
            warnings.append(anatomy(sentence("loose-tissue", count=len(stranded), places=_places(samples, stranded))))
    leaks = find_leaks(samples, pieces, state)
    if leaks:
        places = _places(samples, [pair[0] for pair in leaks])
        warnings.append(anatomy(sentence("wall-with-hole", places=places)))
    blocked, (figures, changes) = side_by_side(
        lambda: blocked_openings(samples, pieces, state, blood_width),
        lambda: _compared(samples, fine_tissue, fine_blood, unrepaired, state),
    )
    if blocked:
        places = _places(samples, blocked)
        warnings.append(anatomy(sentence("opening-shut", count=len(blocked), places=places)))
    quality: dict[str, Any] = {
        "repairs": {
            "leak_cells_added": leaks_closed,
            "break_cells_added": joined,
            "openings_opened": opened,
            "opening_cells_removed": cells_opened,
            "hinge_groups_dropped": hinges.dropped_groups,
            "hinge_cells_dropped": hinges.dropped_cells,
            "hinge_groups_joined": hinges.joined_groups,
            "hinge_cells_added": hinges.added_cells,
        },
        "leaks_left": len(leaks),
        "openings_closed": len(blocked),
    }
    quality |= figures
    return state, quality, warnings + _topology_warnings(samples, quality, changes)


def _compared(
    samples: CellSamples, fine_tissue: Bool, fine_blood: Bool, unrepaired: CellState, state: CellState
) -> tuple[dict[str, Any], dict[str, list[Change]]]:
    """Betti numbers of tissue and blood at the samples, before and after the repairs, and where they changed."""
    quality: dict[str, Any] = {}
    figures = (
        ("tissue", 26, fine_tissue, unrepaired.tissue, state.tissue),
        ("blood", 6, fine_blood, unrepaired.is_blood & ~unrepaired.tissue, state.is_blood & ~state.tissue),
    )
    changes: dict[str, list[Change]] = {}
    for name, connectivity, fine, raw, final in figures:
        numbers = [betti_numbers(mask, 6 if connectivity == 6 else 26).as_list() for mask in (fine, raw, final)]
        quality[f"betti_{name}"] = {"full_resolution": numbers[0], "unrepaired": numbers[1], "grid": numbers[2]}
        amount = samples.coverage if name == "tissue" else np.float32(1.0) - samples.coverage
        quality[f"{name}_pieces_over_a_cell"] = {
            "full_resolution": _piece_count(fine, None, samples.factor**3, connectivity),
            "grid": _piece_count(final, amount, 1.0, connectivity),
        }
        cells = final.repeat(samples.factor, 0).repeat(samples.factor, 1).repeat(samples.factor, 2)
        changes[name] = topology_changes(
            fine, cells, samples.tissue_mm, 6 if connectivity == 6 else 26, reach=samples.factor
        )
        quality[f"{name}_changes"] = len(changes[name])
    quality["change_places_mm"] = {
        name: [[round(x, 1) for x in _place(samples, change)] for change in found[:_LISTED_PLACES]]
        for name, found in changes.items()
    }
    return quality, changes


def _piece_count(mask: Bool, amount: Float32 | None, least: float, connectivity: int) -> int:
    """Number of connected pieces that hold at least an amount; without amounts, as many voxels."""
    labels, count = components(mask, 6 if connectivity == 6 else 26)
    if amount is None:
        return int((piece_sizes(labels.ravel(), count)[1:] >= least).sum())
    return int((np.bincount(labels.ravel(), amount.ravel(), minlength=count + 1)[1:] >= least).sum())


def _topology_warnings(
    samples: CellSamples, quality: dict[str, Any], changes: dict[str, list[Change]]
) -> list[CaseWarning]:
    """Where the number of pieces larger than a cell differs, and where small gaps and strands differ."""
    warnings: list[CaseWarning] = []
    left = dict(changes)
    for name in ("tissue", "blood"):
        pieces = quality[f"{name}_pieces_over_a_cell"]
        was, now = pieces["full_resolution"], pieces["grid"]
        # Without a change the same pieces are there, and one of them is about as large as a cell.
        if was != now and changes[name]:
            kind = f"{name}-apart" if now > was else f"{name}-joined"
            places = _named([_place(samples, one) for one in changes[name]])
            warnings.append(anatomy(sentence(kind, count=was, now=now, places=places)))
            left[name] = []
    blood, tissue = ([_place(samples, change) for change in changes[name]] for name in ("blood", "tissue"))
    if blood and tissue:
        # What closes a hole of the tissue may break a loop of the blood: the same place twice.
        away_mm = np.atleast_1d(cKDTree(np.array(blood)).query(np.array(tissue))[0])
        tissue = [place for place, away in zip(tissue, away_mm, strict=True) if away > samples.cell_mm]
    where = [*(blood if left["blood"] else ()), *(tissue if left["tissue"] else ())]
    if where:
        is_whole = not (warnings or left["blood"] or quality["leaks_left"] or quality["openings_closed"])
        said = {"cell": f"{samples.cell_mm:.1f}", "count": len(where), "places": _named(where[:_SMALL_PLACES])}
        first = "the first " if len(where) > _SMALL_PLACES else ""
        kind = "small-gaps-chambers-kept" if is_whole else "small-gaps"
        warnings.append(note(sentence(kind, **(said | {"places": f"{first}at {said['places']}"}))))
    return warnings


def _place(samples: CellSamples, change: Change) -> list[float]:
    """World position of a change, mm."""
    cell = (np.array(change.place[::-1]) + 0.5) / samples.factor - 0.5
    return [float(x) for x in samples.geometry.index_to_world(cell)]


def _places(samples: CellSamples, cells: Sequence[Index]) -> str:
    """The first few cells (k, j, i) as world positions in mm."""
    return _named([[float(x) for x in samples.geometry.index_to_world(cell[::-1])] for cell in sorted(set(cells))])


def _named(places: Sequence[Sequence[float]]) -> str:
    """The first few world positions, mm, in words."""
    named = [f"({x:.1f}, {y:.1f}, {z:.1f})" for x, y, z in places[:_NAMED_PLACES]]
    more = len(places) - len(named)
    return ", ".join(named) + " mm" + (f" and {more} more" if more else "")


def _labels_of_cells(sampled: UInt8, tissue: Bool) -> UInt8:
    """Label of every tissue cell; one that a repair added and that holds none takes the commonest near it.

    Near are the cells of the smallest cube around it that holds a tissue cell with a label (ties: the lowest label).
    """
    label = sampled.copy()
    known = np.where(tissue, sampled, 0)
    for place in np.argwhere(tissue & (sampled == 0)).tolist():
        for reach in range(1, max(tissue.shape) + 1):
            near = known[tuple(slice(max(at - reach, 0), at + reach + 1) for at in place)]
            if near.any():
                label[tuple(place)] = np.bincount(near[near > 0]).argmax()
                break
    return label


def _boundary(samples: CellSamples, pieces: VoidPieces, state: CellState, corners: Int32) -> tuple[Int32, UInt8, Int32]:
    """Faces between tissue and void cells, by cell and then by direction.

    The label of a face is that of most of the void samples next to it in the void cell's main piece; where none of
    them touches the face, of most of that piece; 0 beyond the region of interest.
    """
    tissue = np.pad(state.tissue, 1)
    k, j, i = np.nonzero(state.tissue)
    steps = np.array([(0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0)])
    beside = np.stack((k, j, i), axis=1)[:, None, :] + steps[None]
    is_face = ~tissue[beside[..., 0] + 1, beside[..., 1] + 1, beside[..., 2] + 1]
    face_cell, side = np.nonzero(is_face)
    faces = corners[face_cell[:, None], FACE_CORNERS[side]]
    label = np.zeros(len(faces), np.uint8)
    _label_faces(pieces.piece, state.main, samples.void_label, samples.factor, beside[face_cell, side], side, label)
    return np.ascontiguousarray(faces), label, face_cell.astype(np.int32)


def _tissue_volume_mm3(samples: CellSamples) -> float:
    return float(samples.coverage.sum(dtype=np.float64)) * samples.cell_mm**3


def _thickness_percentiles(samples: CellSamples) -> dict[str, float]:
    """Local thickness of the tissue, in cells: twice the depth at the ridges of the distance to the void."""
    tissue = np.pad(samples.tissue, 1, mode="edge")
    depth = distance_in_samples(tissue)
    ridge = np.empty(samples.tissue_mm.shape, np.float32)
    _find_ridges(tissue, depth, ridge)
    ridge = ridge[ridge > 0.0]
    if len(ridge) == 0:
        return {}
    values = np.percentile((2.0 * ridge - 1.0) / samples.factor, [5, 25, 50, 75, 95])
    return {name: float(value) for name, value in zip(("p5", "p25", "p50", "p75", "p95"), values, strict=True)}


@called
def _find_ridges_of_plane(tissue, depth, ridge, z):
    """Find them in one plane."""
    ny, nx = ridge.shape[1:]
    half = np.float32(0.5)
    for y in range(ny):
        for x in range(nx):
            ridge[z, y, x] = 0.0
            here = depth[z + 1, y + 1, x + 1]
            if not tissue[z + 1, y + 1, x + 1]:
                continue
            a, b = depth[z, y + 1, x + 1], depth[z + 2, y + 1, x + 1]
            c, d = depth[z + 1, y, x + 1], depth[z + 1, y + 2, x + 1]
            e, f = depth[z + 1, y + 1, x], depth[z + 1, y + 1, x + 2]
            if max(a, b, c, d, e, f) > here:
                continue
            height = max(here, half * (a + b) + (here - min(a, b)), half * (c + d) + (here - min(c, d)))
            ridge[z, y, x] = max(height, half * (e + f) + (here - min(e, f)))


@loop_kernel
def _find_ridges(tissue, depth, ridge):
    """Depth at the samples that are as deep as their six neighbours, 0 elsewhere; the first two are a sample wider.

    Across a wall the depth is a roof; its height follows from the steeper side and both neighbours.
    """
    for z in numba.prange(len(ridge)):
        _find_ridges_of_plane(tissue, depth, ridge, z)


@kernel
def _label_faces(piece, main, void_label, s, beside, side, label):
    nk, nj, ni = main.shape
    share = np.zeros(256, np.int64)
    near = np.zeros(256, np.int64)
    for f in range(len(beside)):
        k, j, i = beside[f]
        if min(k, j, i) < 0 or k >= nk or j >= nj or i >= ni or main[k, j, i] == 0:
            continue
        share[:] = 0
        near[:] = 0
        axis = 2 - side[f] // 2
        layer = s - 1 if side[f] % 2 == 0 else 0
        for a in range(s):
            for b in range(s):
                for c in range(s):
                    z, y, x = k * s + a, j * s + b, i * s + c
                    if piece[z, y, x] != main[k, j, i]:
                        continue
                    share[void_label[z, y, x]] += 1
                    if (a if axis == 0 else (b if axis == 1 else c)) == layer:
                        near[void_label[z, y, x]] += 1
        if near.max() > 0:
            label[f] = near.argmax()
        else:
            label[f] = share.argmax()
