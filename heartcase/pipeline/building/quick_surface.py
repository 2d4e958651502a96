"""The surface of a recipe as it is now, coarse and quick: with its walls, vessel ends and edits, before it is built.

The same functions as in a build make it, on labels of which only some voxels are taken; so a hole, a patch or a thicker
wall is seen where the build will put it, to about a voxel of the coarse lattice. What is too thin for that lattice is
made thicker, so that it stays in one piece and has no holes: walls to some 0.6 of its voxels, lumens by up to a voxel.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heartcase.pipeline.building.thin_lumens import thin_lumens
from heartcase.pipeline.data import UNMARKED, Segmentation, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.reader import ownership_at_points
from heartcase.pipeline.kernels.parallel import in_one_thread
from heartcase.pipeline.mesh.extraction.extract import extract
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.pipeline.walls.septa import open_places
from heartcase.schemas.arrays import Bool, Float32, Float64, Int8, Int32, Int64, UInt8
from heartcase.schemas.errors import Problem, StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.settings import Stroke

__all__ = [
    "FIRST_SHARE",
    "VOXELS",
    "QuickSurface",
    "Thinned",
    "quick_surface",
    "room_around",
    "thinned_lattice",
    "thinning_steps",
]

VOXELS = 90_000
"""Voxels of the coarse lattice: what is quick."""
MOST_VOXELS = 1_500_000
"""Up to so many all voxels are taken, where an end or an edit meets nothing on the coarse lattice."""
MOST_IN_ONE_THREAD = 2 * VOXELS
"""Voxels up to which one thread makes the surface."""
POINTS = 500_000
"""Points of the lattice that the surface is extracted on."""
FIRST_SHARE = 0.2
"""Of voxels and points, for a first look."""
LAYER_SPACINGS = 1.05
"""Thickness of the thinnest wall, over how far those points are apart: from 1 on, an edge between two of them cannot
step over a flat wall, and they may be up to 4% further apart along an axis than on average."""
MARGIN_MM = 6.0
"""Room around the labels beside the thickest wall."""
_LINE = re.compile(r"^(ends|edits)\[(\d+)\]")
_Line = tuple[str, int]
"""A list of the recipe, and the number of a line in it, from 1."""


@dataclass(frozen=True)
class QuickSurface:
    """A closed surface, and what kept something from it."""

    vertices_mm: Float32
    """LPS mm, shape (vertex_count, 3)."""
    normals: Int8
    """127 times the unit normal, out of the tissue, shape (vertex_count, 3)."""
    colours: UInt8
    """Red, green and blue, shape (vertex_count, 3): of the cavity in front, or of the tissue where it is seen from
    outside."""
    triangles: Int32
    """Counter-clockwise from outside the tissue, shape (triangle_count, 3)."""
    spacing_mm: tuple[float, float, float]
    """Distance of the voxels that were taken."""
    problems: tuple[Problem, ...]
    """What is wrong with ends or edits; these are not in the surface then."""


class Thinned(NamedTuple):
    """Labels on a lattice that may be coarser than the scan's."""

    segmentation: Segmentation
    """The labels."""
    is_thin: Bool | None = None
    """Which of its voxels are of thin lumens, of the labels' shape: the smoothing leaves them their label."""


def quick_surface(
    given: Segmentation | Thinned, recipe: Recipe, strokes: Sequence[Stroke] = (), *, is_coarse: bool = False
) -> QuickSurface:
    """Make the surface, coarsely.

    Parameters
    ----------
    given
        Labels as they are now; voxels without a label count as background.
    recipe
        Walls, ends and edits.
    strokes
        Painted strokes beside those of the recipe: a stroke over two cavities opens the septum there.
    is_coarse
        Whether it is made of a fifth of the voxels and points, for a first look.

    Raises
    ------
    StageError
        Nothing is segmented, or there is no tissue.
    """
    table = recipe.table
    whole = given if isinstance(given, Thinned) else Thinned(given)
    near = _cropped(whole._replace(segmentation=replace(whole.segmentation, table=table)), recipe)
    share = FIRST_SHARE if is_coarse else 1.0
    coarse = _thinned(near, share)
    has_all_too = coarse is not near and not is_coarse and near.segmentation.labels.size <= MOST_VOXELS
    tries = [coarse, near] if has_all_too else [coarse]
    problems: tuple[Problem, ...] = ()
    wrong: frozenset[_Line] = frozenset()
    # Without what is wrong, so that the rest is seen; problems of all parts are told.
    while True:
        found: tuple[Problem, ...] = ()
        asked, ends = _without(recipe, wrong)
        for one in tries:
            try:
                return _made(one, asked, strokes, problems, share)
            except StageError as error:
                found = tuple(_as_in_recipe(problem, ends) for problem in error.problems)
        problems = (*problems, *(one for one in found if one not in problems))
        named = frozenset(line for line in map(_line_of, found) if line is not None)
        if named <= wrong:
            break
        wrong |= named
    # where no line is to blame, all edits are left out, and then all ends
    plain = asked.model_copy(update={"edits": ()})
    try:
        return _made(coarse, plain, strokes, problems, share)
    except StageError as error:
        problems = (*(one for one in error.problems if one not in problems), *problems)
    bare = plain.model_copy(update={"ends": (), "walls": recipe.walls.model_copy(update={"find_ends": False})})
    return _made(coarse, bare, strokes, problems, share)


def _without(recipe: Recipe, wrong: frozenset[_Line]) -> tuple[Recipe, list[int]]:
    """A recipe without some lines, and which of its ends are left, from 1; edits keep their numbers."""
    ends = [number for number in range(1, len(recipe.ends) + 1) if ("ends", number) not in wrong]
    edits = tuple(
        edit.model_copy(update={"enabled": False}) if ("edits", number) in wrong else edit
        for number, edit in enumerate(recipe.edits, start=1)
    )
    return recipe.model_copy(update={"ends": tuple(recipe.ends[n - 1] for n in ends), "edits": edits}), ends


def _line_of(problem: Problem) -> _Line | None:
    """The line that a problem names, if it is an end or an edit."""
    found = _LINE.match(problem.place)
    return None if found is None else (found[1], int(found[2]))


def _as_in_recipe(problem: Problem, ends: Sequence[int]) -> Problem:
    """A problem with the number that an end has in the recipe."""
    line = _line_of(problem)
    if line is None or line[0] != "ends":
        return problem
    name, number = line
    return replace(problem, place=_LINE.sub(f"{name}[{ends[number - 1]}]", problem.place))


def _made(
    thinned: Thinned, recipe: Recipe, strokes: Sequence[Stroke], problems: tuple[Problem, ...], share: float
) -> QuickSurface:
    """The surface of these labels: of few in one thread, as strokes and pictures need the cores too."""
    segmentation = thinned.segmentation
    is_little = segmentation.labels.size <= MOST_IN_ONE_THREAD
    with in_one_thread() if is_little else nullcontext():
        return _surface(_structures(thinned, recipe, strokes, share), segmentation, problems, share)


def _structures(thinned: Thinned, recipe: Recipe, strokes: Sequence[Stroke], share: float) -> Structures:
    walls = recipe.walls_to_grow
    painted = (*recipe.strokes, *strokes)
    places = (
        open_places(painted, recipe.landmarks, recipe.table, recipe.walls.contact) if walls.septa == "grown" else ()
    )
    grown = grow_walls(
        thinned.segmentation, walls, recipe.ends, open_places=places, is_measured=False, kept=thinned.is_thin
    )
    return apply_edits(_thickened(grown, share), recipe.edits)


def _thickened(structures: Structures, share: float) -> Structures:
    """Walls and septa as thick at least as the points of the surface are apart: a thinner one would have holes."""
    geometry = structures.geometry
    volume_mm3 = float(np.prod(geometry.size)) * geometry.voxel_volume_mm3
    least_mm = LAYER_SPACINGS * float(np.cbrt(volume_mm3 / (share * POINTS)))
    thinnest_mm = structures.thinnest_layer_mm
    if thinnest_mm is None or thinnest_mm >= least_mm:
        return structures
    labels = tuple(
        label.model_copy(update={"wall_thickness_mm": max(label.wall_thickness_mm, least_mm)})
        if label.wall_thickness_mm > 0.0
        else label
        for label in structures.table
    )
    tables = tuple(
        one._replace(thickness_mm=tuple(max(mm, least_mm) if mm > 0.0 else 0.0 for mm in one.thickness_mm))
        for one in structures.thickness_tables
    )
    septa = tuple(one._replace(thickness_mm=max(one.thickness_mm, least_mm)) for one in structures.septa)
    return replace(structures, table=LabelTable(labels=labels), thickness_tables=tables, septa=septa)


def _surface(
    structures: Structures, segmentation: Segmentation, problems: tuple[Problem, ...], share: float
) -> QuickSurface:
    mesh = extract(structures, point_cap=int(share * POINTS))
    owner = ownership_at_points(structures, mesh.vertices_mm)
    palette = _palette(structures.table)
    colours = np.where((mesh.void_label == BACKGROUND)[:, None], palette[owner.tissue_label], palette[mesh.void_label])
    spacing = segmentation.geometry.spacing_mm
    normals = _normals(mesh.vertices_mm, mesh.triangles)
    return QuickSurface(
        mesh.vertices_mm.astype(np.float32), normals, colours.astype(np.uint8), mesh.triangles, spacing, problems
    )


def _cropped(whole: Thinned, recipe: Recipe) -> Thinned:
    """The part around the labels and all that the recipe places."""
    segmentation = whole.segmentation
    geometry, labels = segmentation.geometry, segmentation.labels
    # in one pass over the scan: labels but the background's, which is 0, and none
    is_labelled: Bool = labels - np.uint8(1) < np.uint8(UNMARKED - 1)
    rows: Bool = np.any(is_labelled, axis=2)
    there = [np.flatnonzero(rows.any(axis=0)), np.flatnonzero(rows.any(axis=1))]
    if not len(there[0]):
        raise StageError("nothing is segmented but background: paint the structures first", place="segment")
    along, slices = (slice(one[0], one[-1] + 1) for one in there)
    there.insert(0, np.flatnonzero(is_labelled[slices, along].any(axis=(0, 1))))
    corners = np.array([[one[0], one[-1]] for one in there], dtype=float).T
    low, high = room_around(corners, geometry, recipe)
    box = slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0])
    part = labels[box]
    part = np.where(part == UNMARKED, np.uint8(BACKGROUND), part)
    i, j, k = (int(one) for one in low)
    near = replace(segmentation, labels=part, geometry=geometry.cropped((i, j, k), part.shape[::-1]))
    return Thinned(near, None if whole.is_thin is None else whole.is_thin[box])


def room_around(corners: Float64, geometry: Geometry, recipe: Recipe) -> tuple[Int64, Int64]:
    """The voxels around labels and all that the recipe places, with room for walls.

    Parameters
    ----------
    corners
        First and last voxel (i, j, k) of what is labelled, shape (2, 3).
    geometry
        Lattice of the labels.
    recipe
        Walls, ends and edits.

    Returns
    -------
    low, high
        First voxel (i, j, k), and that behind the last.
    """
    placed = [(end.position_mm, 0.0) for end in recipe.ends]
    for edit in recipe.edits:
        if edit.kind in ("septal_defect", "close_defect"):
            placed.append((edit.position_mm, 0.5 * edit.diameter_mm))
        elif edit.kind in ("add", "remove", "smooth", "fill"):
            placed += [(point, edit.radius_mm) for point in edit.points_mm]
    if placed:
        size = np.array(geometry.size) - 1
        middles = geometry.world_to_index(np.array([point for point, _ in placed]))
        reach = np.array([[radius] for _, radius in placed]) / np.array(geometry.spacing_mm)
        corners = np.vstack([corners, np.clip(middles - reach, 0, size), np.clip(middles + reach, 0, size)])
    margin = (MARGIN_MM + recipe.walls.thickest_mm(recipe.table)) / np.array(geometry.spacing_mm)
    low = np.maximum(np.floor(corners.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0) + margin) + 1, geometry.size).astype(int)
    return low, high


def thinning_steps(size: Int64, spacing_mm: Float64, voxels: float) -> Int64:
    """Every how many voxels one is taken along i, j and k, so that about so many are left, about as far apart."""
    apart_mm = float(np.cbrt(size.prod() * spacing_mm.prod() / voxels))
    steps: Int64 = np.maximum(np.rint(apart_mm / spacing_mm), 1).astype(np.int64)
    return steps


def thinned_lattice(geometry: Geometry, first: Int64, steps: Int64, size: tuple[int, ...]) -> Geometry:
    """The lattice of every n-th voxel from a first one (i, j, k) on."""
    spacing = np.array(geometry.spacing_mm) * steps
    return geometry.model_copy(
        update={
            "size": size,
            "spacing_mm": tuple(float(one) for one in spacing),
            "origin_mm": tuple(float(one) for one in geometry.index_to_world(first)),
        }
    )


def _thinned(whole: Thinned, share: float) -> Thinned:
    """Every second voxel or fewer, about as far apart along all axes, and thin lumens; as it is where all are taken."""
    segmentation = whole.segmentation
    geometry = segmentation.geometry
    steps = thinning_steps(np.array(geometry.size), np.array(geometry.spacing_mm), share * VOXELS)
    if (steps == 1).all():
        return whole
    first = steps // 2
    i, j, k = (slice(int(start), None, int(step)) for start, step in zip(first, steps, strict=True))
    labels = np.ascontiguousarray(segmentation.labels[k, j, i])
    labels, is_thin = thin_lumens(segmentation.labels, labels, steps, first, segmentation.table)
    if whole.is_thin is not None:
        is_thin |= whole.is_thin[k, j, i] & (labels == segmentation.labels[k, j, i])
    coarse = thinned_lattice(geometry, first, steps, labels.shape[::-1])
    return Thinned(replace(segmentation, labels=labels, geometry=coarse), is_thin)


def _palette(table: LabelTable) -> UInt8:
    colours = np.full((256, 3), 160, np.uint8)
    for label in table:
        colours[label.value] = [int(label.colour[at : at + 2], 16) for at in (1, 3, 5)]
    return colours


def _normals(vertices: Float64, triangles: Int32) -> Int8:
    """Normals of the vertices, by the area of the triangles around them."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    faces = np.cross(b - a, c - a)
    found = np.empty((len(vertices), 3))
    for axis in range(3):
        found[:, axis] = np.bincount(triangles.ravel(), weights=np.repeat(faces[:, axis], 3), minlength=len(vertices))
    length = np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
    normals: Int8 = np.rint(127.0 * found / length).astype(np.int8)
    return normals
