"""Distance fields of the structures, and walls grown outward from the cavities (thesis 11.2.3).

Only the bare structures get a field here. Where two cavities touch that a heart does not join, a septum is grown
between them: :mod:`heartcase.pipeline.walls.septa`. A wall is a thickness in the label table, or a table of thicknesses
by place, worked out by :mod:`heartcase.pipeline.fields.reader` wherever it is asked for, so it is exact however thin it
is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace

import numpy as np

from heartcase.pipeline.checks.leaks import leak_warnings
from heartcase.pipeline.checks.smoothing_effects import smoothing_effects
from heartcase.pipeline.data import Segmentation, Structures, ThicknessTable
from heartcase.pipeline.fields.distance import default_smoothing_mm, label_distances
from heartcase.pipeline.fields.lattice_kernels import count_owners
from heartcase.pipeline.fields.reader import FieldReader, ownership_on_lattice
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.vessel_ends.cut_ends import cut_ends
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.pipeline.walls.septa import (
    OpenPlace,
    SeptumFigures,
    septum_figures,
    septum_warnings,
    with_septa,
)
from heartcase.pipeline.warning_words import sentence
from heartcase.pipeline.warnings import CaseWarning, anatomy
from heartcase.schemas.arrays import Bool, UInt8
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.recipe.resolved import ResolvedWalls
from heartcase.schemas.recipe.settings import EndMarker, WallsSettings

__all__ = ["grow_walls", "resolve_walls", "structure_volumes_ml"]


BAND_VOXELS = 3.0
"""Voxels beyond the thickest wall up to which the fields are exact by default."""


def grow_walls(
    segmentation: Segmentation,
    settings: WallsSettings,
    ends: Sequence[EndMarker],
    *,
    open_places: Sequence[OpenPlace] = (),
    is_measured: bool = True,
    kept: Bool | None = None,
) -> Structures:
    """Make the structures of a segmentation: smooth distance fields, walls around the cavities, open vessel ends.

    A wall takes the background within its thickness of its cavity, to a fraction of a voxel, and nothing else: it
    enters no other structure. Where two cavities touch that a heart does not join, both give up half of a septum's
    thickness, unless the settings say ``as segmented``; other cavities that touch are open to each other. Where two
    walls meet, the nearer cavity's wins (ties: the lower label). Where neighbours are closer than both walls together,
    the walls share the room between them. A vessel that the volume's border or an end marker cuts stays open there.

    Parameters
    ----------
    segmentation
        Labels. The thicknesses are those of its table, where the settings say nothing else.
    settings
        Smoothing, band, and thicknesses that vary; the band is at least a voxel more than the thickest wall.
    ends
        Discs beyond which a vessel and its wall are taken away.
    open_places
        Where a septum is open, from :func:`heartcase.pipeline.walls.septa.open_places`.
    is_measured
        Whether figures and warnings are worked out; the structures are the same.
    kept
        Voxels that the smoothing leaves their label, shape ``segmentation.labels.shape``.

    Returns
    -------
    Structures
        On the segmentation's lattice.

    Raises
    ------
    StageError
        Nothing is segmented, a voxel's label is not in the table, a table of thicknesses is for a label that is not
        there or grows no wall, or an end marker lies outside or cuts no vessel in two.
    """
    geometry = segmentation.geometry
    _check(segmentation, settings)
    table = segmentation.table.with_walls()
    spacing = np.array(geometry.spacing_mm)
    chosen = resolve_walls(settings, geometry, table)
    stumps = Stumps.of(chosen, table, geometry.spacing_mm)
    cut = cut_ends(segmentation, table, ends, stumps, find=chosen.find_ends)
    labels = cut.labels
    distances = label_distances(
        labels,
        geometry.spacing_mm,
        smoothing_mm=chosen.smoothing_mm,
        band_mm=chosen.band_mm,
        blood_values=table.blood_values,
        tissue_values=table.tissue_values,
        kept=None if kept is None else kept & (labels == segmentation.labels),
    )
    if BACKGROUND not in distances:
        far = float(np.linalg.norm(spacing * np.array(geometry.size)))
        distances[BACKGROUND] = np.full(geometry.shape, far, np.float32)
    axes = [np.array(end.axis) / np.linalg.norm(end.axis) for end in cut.ends]
    structures = Structures(
        distance_mm=dict(sorted(distances.items())),
        geometry=geometry,
        table=table,
        band_mm=chosen.band_mm,
        fixed_planes=tuple(
            (end.position_mm, (float(axis[0]), float(axis[1]), float(axis[2])), end.radius_mm)
            for end, axis in zip(cut.ends, axes, strict=True)
        ),
        reshapings=cut.reshapings,
        vessel_ends=cut.vessel_ends,
        thickness_tables=tuple(
            ThicknessTable(table[one.label].value, one.kind, one.points_mm, one.thickness_mm)
            for one in chosen.thickness
        ),
        has_voxel_steps=True,
    )
    septa: tuple[SeptumFigures, ...] = ()
    if chosen.septa == "grown":
        structures, septa = with_septa(structures, _labels_on_lattice(structures), chosen, open_places)
    if not is_measured:
        return structures
    leaks, (figures, warnings) = side_by_side(
        lambda: leak_warnings(structures, labels), lambda: smoothing_effects(labels, distances, geometry, table)
    )
    if septa:
        figures = figures | {"septa": septum_figures(septa, structures.table)}
    grown = replace(
        structures,
        quality=figures,
        warnings=(
            *cut.warnings,
            *warnings,
            *_table_warnings(structures),
            *septum_warnings(septa, structures.table),
            *leaks,
        ),
    )
    FieldReader.of(structures).serves(grown)
    return grown


def resolve_walls(settings: WallsSettings, geometry: Geometry, table: LabelTable) -> ResolvedWalls:
    """Settings with the smoothing and the band that they leave to the scan's lattice and the thickest wall filled in.

    A band that is stated is widened to a voxel more than the thickest wall where it is less. Resolved settings come
    back as they are, unless their band is too narrow for this table.
    """
    spacing = np.array(geometry.spacing_mm)
    smoothing = default_smoothing_mm(spacing) if settings.smoothing_mm is None else settings.smoothing_mm
    thickest = settings.thickest_mm(table)
    band = settings.band_mm or thickest + BAND_VOXELS * float(spacing.mean())
    band = max(band, thickest + float(spacing.max()))
    if isinstance(settings, ResolvedWalls) and settings.band_mm == band:
        return settings
    return ResolvedWalls.of(settings, smoothing_mm=smoothing, band_mm=band)


def structure_volumes_ml(structures: Structures, is_wanted: Callable[[], bool] = lambda: True) -> dict[int, float]:
    """Volume of every structure within the volume's voxels, by who owns the eight sub-voxels of each voxel.

    Parameters
    ----------
    structures
        The structures.
    is_wanted
        Asked every 8 million points.

    Returns
    -------
    dict
        Label value -> millilitres, for every label that owns a point.

    Raises
    ------
    CancelledError
        It is not wanted any more.
    """
    fine = structures.geometry.refined(2)
    slab = max(1, 8_000_000 // (fine.size[0] * fine.size[1]))
    counts = np.zeros(256, np.int64)
    for start in range(0, fine.size[2], slab):
        if not is_wanted():
            raise CancelledError
        part = fine.cropped((0, 0, start), (fine.size[0], fine.size[1], min(slab, fine.size[2] - start)))
        owner = ownership_on_lattice(structures, part)
        count_owners(owner.tissue_mm.ravel(), owner.tissue_label.ravel(), owner.void_label.ravel(), counts)
    return {int(value): float(counts[value] * fine.voxel_volume_mm3 / 1000.0) for value in np.flatnonzero(counts)}


def _labels_on_lattice(structures: Structures) -> UInt8:
    """Label of every voxel, walls included."""
    owner = ownership_on_lattice(structures, structures.geometry)
    return np.where(owner.tissue_mm < 0.0, owner.tissue_label, owner.void_label).astype(np.uint8)


def _check(segmentation: Segmentation, settings: WallsSettings) -> None:
    there = [int(value) for value in np.flatnonzero(np.bincount(segmentation.labels.ravel(), minlength=256))]
    unknown = [value for value in there if value not in segmentation.table]
    problems = [
        Problem("walls", f"the segmentation has label value {value}, which the label table does not: add it")
        for value in unknown
    ]
    if there == [BACKGROUND]:
        problems.append(Problem("walls", "nothing is segmented: check the markers and the region of interest"))
    problems += [
        Problem(f"walls.thickness[{number}]", f"there is no label {one.label!r}: check the name")
        for number, one in enumerate(settings.thickness, start=1)
        if segmentation.table.find(one.label) is None
    ]
    problems += settings.thickness_problems(segmentation.table)
    problems += [
        Problem(place, f"there is no label {name!r}: check the name")
        for place, pair in settings.septum_pairs
        for name in pair
        if segmentation.table.find(name) is None
    ]
    problems += settings.septum_problems(segmentation.table)
    if problems:
        raise StageError(problems)


def _table_warnings(structures: Structures) -> tuple[CaseWarning, ...]:
    """Tables of thicknesses that have no effect, or that speak of places elsewhere."""
    warnings: list[CaseWarning] = []
    grown = {cavity for cavity, _ in structures.grown_walls.values()}
    for table in structures.thickness_tables:
        name = structures.table[table.cavity].name
        if table.cavity in structures.distance_mm and table.cavity not in grown:
            warnings.append(CaseWarning(sentence("table-unused", label=name)))
        index = structures.geometry.world_to_index(np.array(table.points_mm))
        if not ((index > -0.5) & (index < np.array(structures.geometry.size) - 0.5)).all(axis=1).any():
            warnings.append(anatomy(sentence("table-outside", label=name)))
    return tuple(warnings)
