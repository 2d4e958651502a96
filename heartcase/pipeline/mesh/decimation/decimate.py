"""Fewer triangles: quadric edge collapse that never breaks the mesh.

Every collapse keeps the mesh a closed manifold (link condition), turns no triangle over and makes no needle; borders
between tags have quadrics of their own, so they stay where they are. Only folds, which many small turns can add up to
or the full mesh already had, are left to be smoothed out afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from heartcase.compiling.kernel import loop_kernel
from heartcase.pipeline.mesh.decimation.collapse import Collapsing, Joined, joined, swept
from heartcase.pipeline.mesh.decimation.edge_heap import finished
from heartcase.pipeline.mesh.triangles.half_edges import opposites
from heartcase.pipeline.mesh.triangles.intersections import self_intersections
from heartcase.schemas.arrays import Bool, Float, Float64, Int32, Integer
from heartcase.schemas.bundle.lattice import distinct_keys

__all__ = [
    "Decimated",
    "MeshDefects",
    "begun_decimation",
    "decimate",
    "decimate_soundly",
    "folded_triangles",
    "mesh_defects",
    "relax_folds",
    "without_folds",
]


FOLD_COSINE = -0.2
FOLD_ROUNDS = 16
CARE_ROUNDS = 10
"""Most times that a mesh is decimated again."""
CARE_FACTOR = 25.0
"""By so much more the error counts each time where the mesh crossed itself: it should become a fifth."""
MOST_COLLAPSED_FOLDS = 20
"""Folds beyond which none is collapsed: each collapse looks at them all."""
CARE_EDGES = 1.0
"""How far around a crossing triangle, in its longest edges."""


@dataclass(frozen=True)
class Decimated:
    """A decimated mesh."""

    vertices_mm: Float64
    """Shape (vertex_count, 3)."""
    triangles: Int32
    """Shape (triangle_count, 3)."""
    relaxed_count: int
    """Vertices that were moved for the sake of folds."""
    care_rounds: int
    """How often it was decimated again."""
    crossing_pairs: Int32
    """Triangles that still pass through each other, shape (pair_count, 2)."""


def decimate(
    vertices: Float64,
    triangles: Int32,
    tags: Integer,
    *,
    triangle_count: int,
    opposite: Int32 | None = None,
    care: Float64 | None = None,
) -> tuple[Float64, Int32, Int32]:
    """Collapse edges in the order of their quadric error until few enough triangles are left.

    Garland and Heckbert, Surface simplification using quadric error metrics, SIGGRAPH 1997, with area weights; link
    condition of Dey et al., Topology preserving edge contraction, Publ. Inst. Math. 66, 1999.

    Parameters
    ----------
    vertices, triangles
        A closed manifold mesh; positions in mm.
    tags
        Tag of each triangle, shape (triangle_count,): borders between tags are kept in place.
    triangle_count
        Stop at this many.
    opposite
        Opposite half-edges, where they are at hand; not changed.
    care
        Factor by which the error counts at each vertex, shape (vertex_count,); 1 where left out.

    Returns
    -------
    vertices : Float64
        Remaining vertices, in their old order.
    triangles : Int32
        Remaining triangles, in their old order. More than asked for where no collapse is allowed any more.
    source : Int32
        Old number of each remaining triangle.
    """
    if len(triangles) <= triangle_count:
        return vertices, triangles, np.arange(len(triangles), dtype=np.int32)
    begun = begun_decimation(vertices, triangles, tags, triangle_count, opposite, care)
    return _result(finished(begun, triangle_count), vertices.mean(axis=0))


def begun_decimation(
    vertices: Float64,
    triangles: Int32,
    tags: Integer,
    triangle_count: int,
    opposite: Int32 | None = None,
    care: Float64 | None = None,
) -> Collapsing:
    """A mesh with most of its edges collapsed, about its middle; parameters as for :func:`decimate`."""
    beside = opposites(triangles) if opposite is None else opposite.copy()
    tail = triangles.astype(np.int32).ravel()
    return swept(
        vertices - vertices.mean(axis=0), tail, beside, np.asarray(tags).astype(np.int64), triangle_count, care
    )


def _result(mesh: Collapsing, middle: Float64) -> tuple[Float64, Int32, Int32]:
    """Vertices and triangles that are left, and the old number of each triangle."""
    there = np.flatnonzero(mesh.alive)
    left = mesh.tail.reshape(-1, 3)[there]
    used = np.unique(left)
    number = np.zeros(len(mesh.position), np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    return mesh.position[used] + middle, number[left], mesh.source[there]


def decimate_soundly(
    vertices: Float64,
    triangles: Int32,
    tags: Integer,
    *,
    triangle_count: int,
    reach_mm: float,
    opposite: Int32 | None = None,
    begun: Collapsing | None = None,
) -> Decimated:
    """Decimate, relax folds, and where the result passes through itself or is folded still, take more care there.

    Where two sheets are nearer to each other than the error of so few triangles, they cross. The last half of the
    collapses is done once more then, with the error counting more around those places, so that triangles go there from
    elsewhere; after that the full mesh is decimated again. From the third time on there are a quarter more triangles
    against crossings, too, and vertices may move twice as far from the fourth.

    Parameters
    ----------
    vertices, triangles, tags, triangle_count
        As for :func:`decimate`.
    reach_mm
        How far a vertex may move for the sake of a fold.
    opposite
        As for :func:`decimate`.
    begun
        The first sweeps, where they are done: :func:`begun_decimation` for the same arguments.

    Returns
    -------
    Decimated
        The last round's mesh; crossing pairs and folds that are left can be counted.
    """
    care = np.ones(len(vertices))
    count = triangle_count
    for turn in range(CARE_ROUNDS + 1):
        if len(triangles) <= count:
            coarse, faces = vertices, triangles
        else:
            if begun is None or turn > 1:
                begun = begun_decimation(vertices, triangles, tags, count, opposite, care if turn else None)
            coarse, faces, _ = _result(finished(begun, count, care if turn == 1 else None), vertices.mean(axis=0))
        coarse, relaxed, pairs = relax_folds(coarse, faces, reach_mm=reach_mm * (1.0 if turn < 3 else 2.0))
        if not len(pairs):
            coarse, faces = without_folds(coarse, faces)
        bad = folded_triangles(coarse, faces)
        bad[pairs.ravel()] = True
        if turn == CARE_ROUNDS or not bad.any():
            break
        corner = coarse[faces[bad]]
        edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
        middle = corner.mean(axis=1)
        upward = np.argsort(middle[:, 2], kind="stable")
        care[_within(vertices, middle[upward], CARE_EDGES * edge[upward])] *= CARE_FACTOR
        if turn >= 2 and len(pairs):
            count += count // 4
    return Decimated(coarse, faces, relaxed, turn, pairs)


def without_folds(vertices: Float64, triangles: Int32) -> tuple[Float64, Int32]:
    """Collapse an edge of each folded triangle, where that leaves fewer folds and nothing crosses.

    Such folds are necks of one lattice cell, which smoothing cannot open.

    Parameters
    ----------
    vertices, triangles
        A closed manifold mesh that does not pass through itself.

    Returns
    -------
    vertices, triangles
        The mesh, with two triangles and a vertex less for each collapse; the same one where none helps.
    """
    was = vertices, triangles
    moved = np.zeros(len(triangles), np.bool_)
    folded = np.flatnonzero(folded_triangles(vertices, triangles))
    while 0 < len(folded) <= MOST_COLLAPSED_FOLDS:
        better = _with_fewer_folds(vertices, triangles, folded)
        if better is None:
            break
        vertices, triangles = better.vertices, better.triangles
        moved = moved[better.kept] | better.moved
        folded = np.flatnonzero(folded_triangles(vertices, triangles))
    return was if len(self_intersections(vertices, triangles, among=moved)) else (vertices, triangles)


def _with_fewer_folds(vertices: Float64, triangles: Int32, folded: Integer) -> Joined | None:
    """The first collapse of an edge of a folded triangle that leaves fewer folds; None where there is none."""
    opposite = opposites(triangles)
    for share in (0.5, 0.0, 1.0):
        for half_edge in (3 * folded[:, None] + np.arange(3)).ravel():
            trial = joined(vertices, triangles, opposite, int(half_edge), share)
            if trial is not None and folded_triangles(trial.vertices, trial.triangles).sum() < len(folded):
                return trial
    return None


def folded_triangles(vertices: Float64, triangles: Int32, *, opposite: Int32 | None = None) -> Bool:
    """Triangles turned over against the mean normal of their three neighbours, by more than about 100 degrees.

    No edge of a solid that is sharp by up to 90 degrees, decimated or not, makes a triangle count.
    """
    beside = opposites(triangles) if opposite is None else opposite
    doubled = np.empty((len(triangles), 3))
    _find_doubled(np.ascontiguousarray(vertices, np.float64), triangles, doubled)
    folded = np.empty(len(triangles), np.bool_)
    _find_folded(doubled, beside, folded)
    return folded


@loop_kernel
def _find_doubled(vertices, triangles, doubled):
    """Find the doubled area of each triangle, along its normal."""
    for t in numba.prange(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        doubled[t, 0] = uy * vz - uz * vy
        doubled[t, 1] = uz * vx - ux * vz
        doubled[t, 2] = ux * vy - uy * vx


@loop_kernel
def _find_folded(doubled, opposite, folded):
    """Find the triangles turned over, by these areas."""
    for t in numba.prange(len(doubled)):
        p, q, r = opposite[3 * t] // 3, opposite[3 * t + 1] // 3, opposite[3 * t + 2] // 3
        together, own, around = 0.0, 0.0, 0.0
        for axis in range(3):
            one = doubled[t, axis]
            beside = doubled[p, axis] + doubled[q, axis] + doubled[r, axis]
            together += one * beside
            own += one * one
            around += beside * beside
        folded[t] = together < FOLD_COSINE * np.sqrt(own) * np.sqrt(around)


def _within(vertices: Float64, middles: Float64, reaches: Float64) -> Bool:
    """Whether a vertex is within the reach of one of some places, mm, which ascend along z."""
    near = np.zeros(len(vertices), np.bool_)
    _note_within(vertices, middles, reaches, reaches.max(), near)
    return near


@loop_kernel
def _note_within(vertices, middles, reaches, most, near):
    """Note them in ``near``; ``most`` is the longest reach."""
    for v in numba.prange(len(vertices)):
        for n in range(np.searchsorted(middles[:, 2], vertices[v, 2] - most), len(middles)):
            if middles[n, 2] > vertices[v, 2] + most:
                break
            x, y, z = (
                vertices[v, 0] - middles[n, 0], vertices[v, 1] - middles[n, 1], vertices[v, 2] - middles[n, 2],
            )  # fmt: skip
            if x * x + y * y + z * z <= reaches[n] * reaches[n]:
                near[v] = True
                break


def relax_folds(vertices: Float64, triangles: Int32, *, reach_mm: float) -> tuple[Float64, int, Int32]:
    """Smooth the corners of folded and of crossing triangles, and nothing else, until none is left or it does not help.

    Parameters
    ----------
    vertices, triangles
        A closed manifold mesh.
    reach_mm
        How far a vertex may move.

    Returns
    -------
    vertices : Float64
        The mesh without folds and crossings, or with fewer.
    moved : int
        Number of vertices that were moved.
    crossing_pairs : Int32
        Triangles that still pass through each other, shape (pair_count, 2).
    """
    opposite = opposites(triangles)
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    start = vertices

    pairs = self_intersections(vertices, triangles)

    def crossing(vertices: Float64) -> Int32:
        changed = (vertices != start).any(axis=1)[triangles].any(axis=1)
        left = pairs[~changed[pairs].any(axis=1)]
        return np.concatenate([left, self_intersections(vertices, triangles, among=changed)])

    def judged(vertices: Float64) -> Bool:
        bad = folded_triangles(vertices, triangles, opposite=opposite)
        if len(pairs):
            bad[crossing(vertices).ravel()] = True
        return bad

    bad = judged(vertices)
    fewest, best = int(bad.sum()), vertices
    for turn in range(FOLD_ROUNDS):
        if not bad.any():
            break
        chosen = np.zeros(len(vertices), bool)
        chosen[triangles[bad]] = True
        if turn >= FOLD_ROUNDS // 2:
            chosen[triangles[chosen[triangles].any(axis=1)]] = True
        edge = chosen[tail]
        number = np.cumsum(chosen) - 1
        total = np.zeros((int(chosen.sum()), 3))
        np.add.at(total, number[tail[edge]], vertices[head[edge]])
        count = np.bincount(number[tail[edge]], minlength=len(total))
        way = vertices[chosen] + 0.5 * (total / count[:, None] - vertices[chosen]) - start[chosen]
        length = np.linalg.norm(way, axis=1)
        vertices = vertices.copy()
        vertices[chosen] = start[chosen] + way * np.minimum(1.0, reach_mm / np.maximum(length, 1e-12))[:, None]
        bad = judged(vertices)
        if bad.sum() < fewest:
            fewest, best = int(bad.sum()), vertices
    moved = int((best != start).any(axis=1).sum())
    return best, moved, crossing(best) if moved else pairs


class MeshDefects(dict[str, int]):
    """Counts of what must not be in a mesh: open and non-manifold edges, degenerate and duplicate triangles."""

    @property
    def is_clean(self) -> bool:
        """Whether all counts are zero."""
        return not any(self.values())


def mesh_defects(vertices: Float, triangles: Int32) -> MeshDefects:
    """Count the defects of a mesh.

    Parameters
    ----------
    vertices, triangles
        The mesh.

    Returns
    -------
    MeshDefects
        ``open_edge_count`` (edges of one triangle), ``non_manifold_edge_count`` (edges of more than two, or of two that
        run the same way), ``degenerate_triangle_count`` (a corner twice, or no area in float64),
        ``duplicate_triangle_count`` and ``unused_vertex_count``.
    """
    width = max(len(vertices), 1)
    tail = triangles.astype(np.int64)
    head = np.roll(tail, -1, axis=1)
    low, high = np.minimum(tail, head).ravel(), np.maximum(tail, head).ravel()
    _, inverse, count = np.unique(low * width + high, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse, weights=np.where((tail < head).ravel(), 1.0, -1.0))
    corner = vertices[triangles].astype(np.float64)
    doubled = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    repeated = (tail == head).any(axis=1)
    ordered = np.sort(tail, axis=1)
    distinct = len(distinct_keys((ordered[:, 0] * width + ordered[:, 1]) * width + ordered[:, 2]))
    return MeshDefects(
        open_edge_count=int((count == 1).sum()),
        non_manifold_edge_count=int(((count > 2) | ((count == 2) & (balance != 0.0))).sum()),
        degenerate_triangle_count=int((repeated | (doubled <= 0.0)).sum()),
        duplicate_triangle_count=len(triangles) - distinct,
        unused_vertex_count=len(vertices) - len(distinct_keys(tail)),
    )
