"""How far a case whose scan is synthetic is from the heart that it was made from.

Labels are compared on the scan's lattice, the surface at its vertices, and every septal defect by rays from the axis
of its canal to its wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from heartcase.library.diff import mesh_of
from heartcase.library.openings import FalseOpening, false_openings
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.truth import Truth
from heartcase.phantom.metrics import SurfaceError, dice
from heartcase.pipeline.formats.read_scan import read_labels
from heartcase.schemas.arrays import Bool, Float64, Int32, UInt8
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.phantom_scan import PhantomScan

__all__ = ["CaseCheck", "DefectCheck", "check_case", "joined_cavities"]

_SAMPLE_COUNT = 3000
"""Vertices of the surface that are measured: the truth takes about 1 ms for each."""
_TOLERANCE_MM = 0.03
_BEYOND_MM = 6.0
"""How far beyond a canal's true wall its wall in the case is looked for."""
_RIM_MM = 0.75
"""Least length along the axis on which a hole's wall is one, in a direction."""
_STEP_MM = 0.05
_LEAST_PIECE, _LEAST_PART = 30, 10
"""Voxels below which a piece of blood, and a cavity's part in one, is a speck."""


@dataclass(frozen=True)
class DefectCheck:
    """A septal defect as it came out."""

    kind: str
    """Which one."""
    diameter_mm: float
    """Diameter of the circle with the area of its true cross-section."""
    diameter_error_mm: float | None
    """How much wider the hole in the case is; None where there is none."""
    position_error_mm: float | None
    """Distance of its middle from the true one, across the canal."""


@dataclass(frozen=True)
class CaseCheck:
    """A case against its truth."""

    name: str
    """Name of the case."""
    tissue_dice: float
    """Dice coefficient of all tissue together."""
    dice: dict[str, float]
    """The same of each structure that is segmented; grown walls are in the tissue."""
    surface: SurfaceError
    """Distance of the surface's vertices from the true border of the tissue."""
    defects: tuple[DefectCheck, ...]
    """Septal defects."""
    joined: tuple[tuple[str, ...], ...]
    """Cavities between which blood passes, in groups."""
    joined_truly: tuple[tuple[str, ...], ...]
    """The same in truth."""
    false_openings: tuple[FalseOpening, ...] = ()
    """Pairs of cavities that are open to each other where they are not in truth."""

    @property
    def is_joined_as_it_should(self) -> bool:
        """Whether exactly those cavities are connected that are in truth."""
        return self.joined == self.joined_truly

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self) | {"is_joined_as_it_should": self.is_joined_as_it_should}


def check_case(case: Path, scan: PhantomScan) -> CaseCheck:
    """Compare a case with the heart that its scan was made from.

    Parameters
    ----------
    case
        The case.
    scan
        The synthetic scan of its recipe.

    Raises
    ------
    BundleError
        It is no case, or a damaged one.
    UsageError
        It holds no surface or no labels.
    """
    bundle = open_bundle(case)
    surface = mesh_of(bundle)
    if surface is None or not bundle.has(FileRole.LABELS):
        raise UsageError("surface and labels are needed: add both to the recipe's parts", place=case.name)
    heart = scan.heart.model_copy(update={"defects": (*scan.heart.defects, *scan.edited_defects)})
    phantom = HeartPhantom.of_form(heart)
    found = read_labels(bundle.path(FileRole.LABELS))
    geometry = found.geometry
    truth = np.empty(geometry.shape, np.uint8)
    j, i = np.indices(geometry.shape[1:])
    for k in range(geometry.shape[0]):
        truth[k] = phantom.truth.label(geometry.index_to_world(np.stack([i, j, np.full_like(i, k)], axis=-1)))
    true_table, table = phantom.truth.table, bundle.manifest.labels
    tissue = np.isin(found.values, table.tissue_values)
    true_tissue = np.isin(truth, true_table.tissue_values)
    by_name = {
        label.name: dice(found.values == own.value, truth == label.value, 1)
        for label in true_table
        if label.value and label.wall_of is None and (own := table.find(label.name)) is not None
    }
    blood = np.isin(found.values, table.blood_values)
    if not blood.any():
        blood = ~tissue & np.isin(truth, true_table.blood_values)
    names = {value: true_table[value].name for value in true_table.blood_values}
    vertices = surface[0]
    some = vertices[np.random.default_rng(0).permutation(len(vertices))[:_SAMPLE_COUNT]]
    return CaseCheck(
        name=bundle.manifest.name,
        tissue_dice=dice(tissue, true_tissue, 1),  # type: ignore[arg-type]
        dice=by_name,
        surface=SurfaceError.of(phantom.truth.tissue_distance(some, tolerance_mm=_TOLERANCE_MM)),
        defects=tuple(
            _defect_check(one.kind, canal, phantom.truth, surface)
            for one, canal in zip(heart.defects, phantom.defects, strict=True)
        ),
        joined=joined_cavities(blood, truth, names),
        joined_truly=joined_cavities(np.isin(truth, true_table.blood_values), truth, names),
        false_openings=false_openings(bundle.manifest.quality.get("openings", ()), phantom.truth),
    )


def joined_cavities(blood: Bool, labels: UInt8, names: dict[int, str]) -> tuple[tuple[str, ...], ...]:
    """Groups of cavities that share a piece of blood.

    Parameters
    ----------
    blood
        Where blood is, [z, y, x]; its pieces are 6-connected.
    labels
        Which cavity a voxel belongs to.
    names
        Label value -> name of each cavity.
    """
    import cc3d

    pieces = cc3d.connected_components(blood, connectivity=6)
    table = np.zeros((int(pieces.max()) + 1, 256), np.int64)
    np.add.at(table, (pieces[blood], labels[blood]), 1)
    groups = []
    for piece in table[1:]:
        inside = [name for value, name in names.items() if piece[value] >= _LEAST_PART]
        if piece.sum() >= _LEAST_PIECE and inside:
            groups.append(tuple(inside))
    return tuple(sorted(set(groups)))


def _defect_check(kind: str, canal: SeptalDefect, truth: Truth, surface: tuple[Float64, Int32]) -> DefectCheck:
    """Width and place of a hole, by rays from the canal's axis to its wall: in truth, and in the case.

    What the rays differ by is fitted by a change of radius and a shift (least squares).
    """
    import pyvista

    axis = np.array(canal.axis) / np.linalg.norm(canal.axis)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[:, None]
    outward = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    along = np.linspace(-0.5, 0.5, 25)[:, None] * canal.length_mm * axis
    start = (np.array(canal.position_mm) + along)[:, None, :] + 0.0 * outward[None]
    outward = np.broadcast_to(outward, start.shape).reshape(-1, 3)
    start = start.reshape(-1, 3)
    reach = 0.5 * canal.diameter_mm + np.arange(-0.5 * canal.diameter_mm, _BEYOND_MM, _STEP_MM)
    solid = np.isin(
        truth.label(start[:, None, :] + reach[None, :, None] * outward[:, None, :]), truth.table.tissue_values
    )
    first = np.argmax(solid, axis=1)
    # The wall of the canal itself, and not what lies beyond where the septum has ended.
    own = solid.any(axis=1) & (first > 0) & (reach[first] < 0.5 * canal.diameter_mm + 2.0 * _STEP_MM)
    triangles = np.hstack([np.full((len(surface[1]), 1), 3), surface[1]]).ravel()
    mesh = pyvista.PolyData(surface[0], triangles)
    # Seen along the axis: the nearest wall in each direction, so that a septum a little before or behind is no gap.
    shape = (len(along), len(turn))
    true_diameter = 2.0 * float(np.sqrt(canal.area_mm2 / np.pi))
    within = np.flatnonzero(own.reshape(shape).any(axis=1))
    if not len(within) or len(mesh.ray_trace(start[within[0] * shape[1]], start[within[-1] * shape[1]])[0]):
        return DefectCheck(kind, true_diameter, None, None)
    least = max(1, round(_RIM_MM / (canal.length_mm / (len(along) - 1))))
    true_reach, wall = [], []
    for direction in range(shape[1]):
        places = np.flatnonzero(own.reshape(shape)[:, direction])
        # A wall that fewer rays meet is a rim seen edge on, where two holes run into each other: it has no one place.
        if len(places) < least:
            continue
        nearest = reach[first.reshape(shape)[places, direction]].min() - 0.5 * _STEP_MM
        found = nearest + _BEYOND_MM
        for place in range(max(places[0] - 2, 0), min(places[-1] + 3, shape[0])):
            n = place * shape[1] + direction
            hit, _ = mesh.ray_trace(start[n], start[n] + (nearest + _BEYOND_MM) * outward[n], first_point=True)
            if len(hit):
                found = min(found, float(np.linalg.norm(hit - start[n])))
        true_reach.append(nearest)
        wall.append(found * np.array((outward[direction] @ side, outward[direction] @ np.cross(axis, side))))

    def residuals(change: Float64) -> Float64:
        rest: Float64 = np.linalg.norm(np.array(wall) - change[1:], axis=1) - np.array(true_reach) - change[0]
        return rest

    change = least_squares(residuals, np.zeros(3)).x
    return DefectCheck(kind, true_diameter, 2.0 * float(change[0]), float(np.linalg.norm(change[1:])))


def problems_of(check: CaseCheck, *, least_dice: float, surface_mm: float, diameter_mm: float) -> Sequence[str]:
    """What of a case is worse than was allowed, in words."""
    problems = []
    if not check.is_joined_as_it_should:
        problems.append("other cavities are connected than in truth")
    problems += [str(one) for one in check.false_openings]
    if check.tissue_dice < least_dice:
        problems.append(f"the tissue's Dice coefficient is {check.tissue_dice:.3f}")
    if check.surface.percentile_95_mm > surface_mm:
        problems.append(f"the surface is off by {check.surface.percentile_95_mm:.2f} mm")
    for defect in check.defects:
        if defect.diameter_error_mm is None:
            problems.append(f"there is no {defect.kind} hole")
        elif abs(defect.diameter_error_mm) > diameter_mm:
            than = "wider" if defect.diameter_error_mm > 0.0 else "narrower"
            problems.append(f"the {defect.kind} hole is {abs(defect.diameter_error_mm):.1f} mm {than} than in truth")
    return problems
