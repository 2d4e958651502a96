"""Writing a deformed surface: PLY and STL (binary) and OBJ (text), whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float32, Int32, UInt8
from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.ply import ply_bytes

__all__ = ["SURFACE_FORMATS", "write_surface"]


def _ply(vertices: Float32, normals: Float32, triangles: Int32, colours: UInt8, comment: str) -> bytes:
    return ply_bytes(vertices, normals, triangles, colours, comments=[comment])


def _stl(vertices: Float32, normals: Float32, triangles: Int32, colours: UInt8, comment: str) -> bytes:
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    facet = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")]))
    facet["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    facet["corners"] = corners
    count = len(triangles).to_bytes(4, "little")
    return comment.encode("ascii")[:80].ljust(80) + count + facet.tobytes()


def _obj(vertices: Float32, normals: Float32, triangles: Int32, colours: UInt8, comment: str) -> bytes:
    lines = [f"# {comment}"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (triangles + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")


def _problems(vertices: Any, normals: Any, triangles: Any, colours: Any) -> list[Problem]:
    """What keeps arrays from being a mesh."""
    count, found = len(np.atleast_1d(vertices)), []
    for name, given in (("vertices_mm", vertices), ("normals", normals)):
        if given.shape != (count, 3) or given.dtype.kind not in "fiu" or not np.isfinite(given).all():
            found.append(Problem(name, f"give finite numbers of shape ({count}, 3) (found {_told(given)})"))
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        problem = f"give vertex numbers of shape (triangle_count, 3) (found {_told(triangles)})"
        return [*found, Problem("triangles", problem)]
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < count:
        found.append(Problem("triangles", f"vertices are numbered from 0 to {count - 1}"))
    if colours.shape != (len(triangles), 3) or colours.dtype != np.uint8:
        found.append(Problem("colours", f"give uint8 of shape ({len(triangles)}, 3) (found {_told(colours)})"))
    return found


def _told(given: Any) -> str:
    return f"{given.dtype} of shape {given.shape}"


SURFACE_FORMATS: dict[str, Callable[[Float32, Float32, Int32, UInt8, str], bytes]] = {
    ".ply": _ply,
    ".stl": _stl,
    ".obj": _obj,
}
"""File name suffix -> its writer."""


def write_surface(
    path: Path | str,
    vertices_mm: Float32,
    normals: Float32,
    triangles: Int32,
    *,
    colours: UInt8 | None = None,
    case_id: str | None = None,
) -> None:
    """Write a triangle mesh in LPS mm; the file appears whole, or the old one stays.

    Parameters
    ----------
    path
        Where to; the suffix says the format: ``.ply``, ``.stl`` or ``.obj``.
    vertices_mm, normals
        Positions in mm and unit normals, shape (vertex_count, 3).
    triangles
        Vertex numbers, shape (triangle_count, 3).
    colours
        Red, green, blue of each triangle, shape (triangle_count, 3); grey when left out. Only PLY keeps them.
    case_id
        Identifier of the case, for the file's comment.

    Raises
    ------
    UsageError
        The suffix is none of these, an array is of another shape or kind or not finite, a triangle has a vertex that
        there is not, or the file cannot be written.
    """
    path = Path(path)
    write = SURFACE_FORMATS.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"a surface is written as {', '.join(SURFACE_FORMATS)}; {path.name!r} is none of these")
    vertices_mm, normals, triangles = np.asarray(vertices_mm), np.asarray(normals), np.asarray(triangles)
    grey = np.full((len(np.atleast_1d(triangles)), 3), 160, np.uint8)
    colours = grey if colours is None else np.asarray(colours)
    problems = _problems(vertices_mm, normals, triangles, colours)
    if problems:
        raise UsageError(problems)
    comment = "patient LPS, mm" + (f"; case {case_id}" if case_id else "")
    try:
        atomic_write(path, write(vertices_mm, normals, triangles, colours, comment))
    except OSError as error:
        raise UsageError(f"{path.name} cannot be written: {error.strerror}") from None
