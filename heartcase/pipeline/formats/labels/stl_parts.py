"""Closed surfaces (.stl) of the parts of a heart, turned into labels on the scan's lattice.

A voxel belongs to a part when its centre has a winding number other than zero: rays along the first axis count the
faces that they pass, with their sense. Vertices are rounded to 1/65536 of a voxel, so that whether a ray passes a
face is decided in whole numbers: a closed surface has no leak, whatever edges and corners the rays run through.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.formats.labels.segments import (
    LabelVolume,
    SegmentInfo,
    count_overlaps,
    in_file_order,
    keep_all,
    stacking_of,
)
from heartcase.pipeline.formats.volumes.raw_volume import check_size, require_file
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.arrays import Bool, Float64, Int16, Int64, UInt8
from heartcase.schemas.errors import HeartcaseError, MarkerError, Problem
from heartcase.schemas.geometry import Geometry

__all__ = ["holds_parts", "inside_of_mesh", "read_parts"]

STEPS = 65536
"""Parts of a voxel that vertices are rounded to."""
REACH = 8192
"""Largest distance of a vertex from the lattice's first voxel, in voxels: products of differences then fit 64 bits."""
RAY_LIMIT = 2**26
"""Most pairs of a face and a ray through its bounding rectangle: some hundred for every ray of a large scan."""
SIZE_LIMIT = 2**30
PART_LIMIT = 250
SYSTEM = re.compile(rb"(?i)\b(?:SPACE|COORDSYS|COORDINATE[ _]?SYSTEM)\s*[=:]\s*([LR][AP][SI])\b")


@dataclass(frozen=True)
class _Mesh:
    vertices_mm: Float64
    """Shape (vertex_count, 3), LPS mm, each place once."""
    triangles: Int64
    """Vertex numbers, shape (triangle_count, 3)."""
    space_is_stated: bool = True
    """Whether the file says that it is LPS or RAS."""


def holds_parts(path: Path) -> bool:
    """Whether this is a folder with .stl files in it."""
    return path.is_dir() and any(file.suffix.lower() == ".stl" for file in path.iterdir())


def read_parts(
    path: Path,
    geometry: Geometry,
    left_out: Callable[[SegmentInfo], bool] = keep_all,
    rank: Callable[[SegmentInfo], int] = in_file_order,
) -> LabelVolume:
    """Read all parts of a folder onto a lattice.

    Parameters
    ----------
    path
        Folder of .stl files, binary or text, in mm. LPS, or RAS where the file's header says so (``SPACE=RAS``,
        ``SPACE: RAS`` or ``COORDSYS=RAS``).
    geometry
        The scan's lattice.
    left_out
        Which parts nobody wants: they take no voxel from others, and count as vanished.
    rank
        How high each part lies; of one rank the later one by the alphabet lies on top.

    Returns
    -------
    LabelVolume
        On ``geometry``. Part n, by the alphabet of the file names, has the value n; where parts overlap the one on top
        wins, and ``overlaps`` says where. The name of a part is its file's, without the ending. Parts that mark no
        voxel are listed as vanished, and a warning says which parts were taken as LPS because they do not say what they
        are.

    Raises
    ------
    MarkerError
        With every part that cannot be read, is not closed, lies far away, or says neither LPS nor RAS and lies on the
        scan better when it is taken as RAS.
    """
    files = sorted(
        (file for file in path.iterdir() if file.suffix.lower() == ".stl"), key=lambda f: (f.name.casefold(), f.name)
    )
    if len(files) > PART_LIMIT:
        raise MarkerError(f"the folder holds more than {PART_LIMIT} parts: keep the parts of the heart alone")
    check_size(geometry.size)
    names = {number: " ".join(file.stem.split())[:64] for number, file in enumerate(files, start=1)}
    infos = {number: SegmentInfo(number, name) for number, name in names.items()}
    stacking = stacking_of(infos.values(), left_out, rank)
    top = np.zeros(geometry.shape, np.uint16)
    is_shared = np.zeros(geometry.shape, bool)
    packed: dict[int, UInt8] = {}
    problems, silent = [], []
    for number, file in enumerate(files, start=1):
        try:
            mesh = _read_stl(file)
            _check_closed(mesh)
            if not mesh.space_is_stated:
                _check_side(mesh.vertices_mm, geometry)
                silent.append(number)
            if stacking.place[number]:
                inside = inside_of_mesh(mesh.vertices_mm, mesh.triangles, geometry)
                is_shared |= inside & (top != 0)
                np.maximum(top, stacking.place[number], out=top, where=inside)
                packed[int(stacking.place[number])] = np.packbits(inside)
        except HeartcaseError as error:
            place = f"part {number} of the folder, by the alphabet"
            problems += [Problem(place, problem.message) for problem in error.problems]
    if problems:
        raise MarkerError(problems)
    shared = np.flatnonzero(is_shared)
    layers = [
        np.unpackbits(bits, count=top.size)[shared].astype(np.uint16) * np.uint16(place)
        for place, bits in packed.items()
        if len(shared)
    ]
    values = stacking.number[top].astype(np.uint8)
    return LabelVolume(
        values,
        geometry,
        infos,
        vanished=tuple(sorted(set(names) - set(np.unique(values).tolist()))),
        warnings=_taken_as_lps(silent),
        overlaps=stacking.overlaps(count_overlaps(layers)),
    )


def _taken_as_lps(silent: list[int]) -> tuple[CaseWarning, ...]:
    if not silent:
        return ()
    numbers = ", ".join(map(str, silent))
    return (
        CaseWarning(
            "LPS was assumed for surfaces of the finished segmentation that say neither LPS nor RAS (by the alphabet: "
            f"part {numbers}): see in the pictures that they lie on the scan"
        ),
    )


def _check_side(vertices_mm: Float64, geometry: Geometry) -> None:
    """Refuse a surface that lies on the scan better when it is taken as RAS."""

    def share_inside(points_mm: Float64) -> float:
        index = geometry.world_to_index(points_mm)
        return float(((index >= -0.5) & (index <= np.array(geometry.size) - 0.5)).all(axis=1).mean())

    if share_inside(vertices_mm * (-1.0, -1.0, 1.0)) > share_inside(vertices_mm):
        raise MarkerError(
            "the surface does not say whether it is in LPS or RAS, and lies on the scan better as RAS: export it as "
            "LPS, or with SPACE=RAS in its first line"
        )


def inside_of_mesh(vertices_mm: Float64, triangles: Int64, geometry: Geometry) -> Bool:
    """Which voxel centres lie inside a closed surface.

    Parameters
    ----------
    vertices_mm
        Vertices, shape (vertex_count, 3), LPS mm.
    triangles
        Vertex numbers, shape (triangle_count, 3); closed, and all turned out or all turned in.
    geometry
        The lattice; oblique, anisotropic and left-handed ones are fine.

    Returns
    -------
    ndarray
        bool, shape ``geometry.shape``.

    Raises
    ------
    MarkerError
        A vertex lies more than 8192 voxels away, or the faces are so many and so large that no organ has them.
    """
    index = geometry.world_to_index(vertices_mm)
    if not (np.abs(index) < REACH).all():
        raise MarkerError("the surface lies far outside the scan: is it in mm, and was it made on this scan?")
    vertices = np.rint(index * STEPS).astype(np.int64)
    if _ray_count(vertices, triangles, geometry) > RAY_LIMIT:
        raise MarkerError(
            "the surface has too many faces that reach across the whole scan: is it in mm, and the surface of an organ?"
        )
    crossings = np.zeros((*geometry.shape[:2], geometry.size[0] + 1), np.int16)
    _count_crossings(vertices, np.asarray(triangles, np.int64), crossings)
    inside: Bool = np.cumsum(crossings[..., :-1], axis=2) != 0
    return inside


def _ray_count(vertices: Int64, triangles: Int64, geometry: Geometry) -> int:
    """How often a ray runs through the bounding rectangle of a face."""
    counts = np.ones(len(triangles), np.int64)
    for axis in (1, 2):
        along = vertices[:, axis][triangles]
        low = np.maximum(0, -(-along.min(axis=1) // STEPS))
        high = np.minimum(geometry.size[axis] - 1, along.max(axis=1) // STEPS)
        counts *= np.maximum(0, high - low + 1)
    return int(counts.sum())


@kernel
def _side(ay: int, az: int, by: int, bz: int, py: int, pz: int) -> int:
    """Sign of the turn a, b, p in the (y, z) plane, never zero: p is moved by an infinitely small (e, e*e)."""
    turn = (by - ay) * (pz - az) - (bz - az) * (py - ay)
    if turn != 0:
        return 1 if turn > 0 else -1
    if bz != az:
        return -1 if bz > az else 1
    if by != ay:
        return 1 if by > ay else -1
    return 0


@kernel
def _count_crossings(vertices: Int64, triangles: Int64, crossings: Int16) -> None:
    nk, nj, ni = crossings.shape[0], crossings.shape[1], crossings.shape[2] - 1
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, az = vertices[a]
        bx, by, bz = vertices[b]
        cx, cy, cz = vertices[c]
        # the ray through lattice point (j, k) stands at j * STEPS, k * STEPS
        low_j = max(0, -((-min(ay, by, cy)) // STEPS))
        high_j = min(nj - 1, max(ay, by, cy) // STEPS)
        low_k = max(0, -((-min(az, bz, cz)) // STEPS))
        high_k = min(nk - 1, max(az, bz, cz) // STEPS)
        for k in range(low_k, high_k + 1):
            pz = k * STEPS
            for j in range(low_j, high_j + 1):
                py = j * STEPS
                side = _side(ay, az, by, bz, py, pz)
                if side == 0 or _side(by, bz, cy, cz, py, pz) != side or _side(cy, cz, ay, az, py, pz) != side:
                    continue
                wa = float((by - py) * (cz - pz) - (bz - pz) * (cy - py))
                wb = float((cy - py) * (az - pz) - (cz - pz) * (ay - py))
                wc = float((ay - py) * (bz - pz) - (az - pz) * (by - py))
                x = (wa * ax + wb * bx + wc * cx) / ((wa + wb + wc) * STEPS)
                crossings[k, j, min(max(0, int(np.ceil(x))), ni)] += side


def _check_closed(mesh: _Mesh) -> None:
    """Refuse a surface with open edges, or with faces turned against their neighbours."""
    ends = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    rising = ends[:, 0] < ends[:, 1]
    _, edge = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    uses = np.bincount(edge.ravel())
    balance = np.bincount(edge.ravel(), weights=np.where(rising, 1.0, -1.0))
    open_count, turned_count = int((uses % 2 == 1).sum()), int(((uses % 2 == 0) & (balance != 0.0)).sum())
    if open_count:
        raise MarkerError(f"the surface is not closed, it has {open_count} open edges: close it, and export it again")
    if turned_count:
        raise MarkerError(
            f"at {turned_count} edges faces are turned against each other: make all normals point outwards"
        )


def _read_stl(file: Path) -> _Mesh:
    require_file(file)
    size = file.stat().st_size
    if size > SIZE_LIMIT:
        raise MarkerError("the file is larger than 1 GiB: reduce the number of triangles, and export it again")
    content = file.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    if size >= 84 and size == 84 + 50 * count:
        records = np.frombuffer(
            content, dtype=[("normal", "<f4", 3), ("corners", "<f4", 9), ("rest", "<u2")], offset=84
        )
        with np.errstate(invalid="ignore"):
            corners = records["corners"].reshape(-1, 3).astype(np.float64)
        header = content[:80]
    elif content[:512].lstrip().lower().startswith(b"solid"):
        lines = re.findall(rb"(?im)^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$", content)
        faces = len(re.findall(rb"(?im)^\s*endfacet", content))
        try:
            corners = np.array([[float(number) for number in line] for line in lines], np.float64).reshape(-1, 3)
        except ValueError:
            corners = np.zeros((0, 3))
        header = content.lstrip().partition(b"\n")[0]
        if len(corners) != 3 * faces:
            raise MarkerError("the file is cut short or damaged: export it again")
    else:
        raise MarkerError("the file is not an STL surface, or is cut short: export it again")
    if not len(corners) or not np.isfinite(corners).all():
        raise MarkerError("the file holds no triangle, or a corner that is not a number: export it again")
    systems = {found.upper() for found in SYSTEM.findall(header)}
    if systems - {b"LPS", b"RAS"} or len(systems) > 1:
        raise MarkerError("the file says that it is in neither LPS nor RAS, or in both: export it in one of them")
    if systems == {b"RAS"}:
        corners = corners * (-1.0, -1.0, 1.0)
    # adding zero makes -0.0 and 0.0 the same place
    vertices, numbers = np.unique(corners + 0.0, axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3).astype(np.int64)
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    if not distinct.any():
        raise MarkerError("the file holds no triangle with an area: export it again")
    return _Mesh(vertices, triangles[distinct], bool(systems))
