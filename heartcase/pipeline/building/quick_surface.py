"""The surface of a recipe as it is now, coarse and quick: with its walls, vessel ends and edits, before it is built.

The same functions as in a build make it, on labels of which only some voxels are taken; so a hole, a patch or a thicker
wall is seen where the build will put it, to about a voxel of the coarse lattice.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

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


def quick_surface(
    segmentation: Segmentation, recipe: Recipe, strokes: Sequence[Stroke] = (), *, is_coarse: bool = False
) -> QuickSurface:
    """Make the surface, coarsely.

    Parameters
    ----------
    segmentation
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
    near = _cropped(replace(segmentation, table=table), recipe)
    share = FIRST_SHARE if is_coarse else 1.0
    coarse, is_thinned = _thinned(near, share)
    tries = [coarse, near] if is_thinned and not is_coarse and near.labels.size <= MOST_VOXELS else [coarse]
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
    segmentation: Segmentation, recipe: Recipe, strokes: Sequence[Stroke], problems: tuple[Problem, ...], share: float
) -> QuickSurface:
    """The surface of these labels: of few in one thread, as strokes and pictures need the cores too."""
    is_little = segmentation.labels.size <= MOST_IN_ONE_THREAD
    with in_one_thread() if is_little else nullcontext():
        return _surface(_structures(segmentation, recipe, strokes), segmentation, problems, share)


def _structures(segmentation: Segmentation, recipe: Recipe, strokes: Sequence[Stroke]) -> Structures:
    walls = recipe.walls_to_grow
    painted = (*recipe.strokes, *strokes)
    places = (
        open_places(painted, recipe.landmarks, recipe.table, recipe.walls.contact) if walls.septa == "grown" else ()
    )
    grown = grow_walls(segmentation, walls, recipe.ends, open_places=places, is_measured=False)
    return apply_edits(grown, recipe.edits)


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


def _cropped(segmentation: Segmentation, recipe: Recipe) -> Segmentation:
    """The part around the labels and all that the recipe places."""
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
    part = labels[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    part = np.where(part == UNMARKED, np.uint8(BACKGROUND), part)
    i, j, k = (int(one) for one in low)
    return replace(segmentation, labels=part, geometry=geometry.cropped((i, j, k), part.shape[::-1]))


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


def _thinned(segmentation: Segmentation, share: float) -> tuple[Segmentation, bool]:
    """Every second voxel or fewer, about as far apart along all axes; and whether any are left out."""
    geometry = segmentation.geometry
    steps = thinning_steps(np.array(geometry.size), np.array(geometry.spacing_mm), share * VOXELS)
    if (steps == 1).all():
        return segmentation, False
    first = steps // 2
    i, j, k = (slice(int(start), None, int(step)) for start, step in zip(first, steps, strict=True))
    labels = np.ascontiguousarray(segmentation.labels[k, j, i])
    coarse = thinned_lattice(geometry, first, steps, labels.shape[::-1])
    return replace(segmentation, labels=labels, geometry=coarse), True


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
