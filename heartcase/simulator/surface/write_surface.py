"""Writing a deformed surface: PLY and STL (binary) and OBJ (text), whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from heartcase.schemas.arrays import Float32, Int32, UInt8
from heartcase.schemas.errors import UsageError
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
        The suffix is none of these, or the file cannot be written.
    """
    path = Path(path)
    write = SURFACE_FORMATS.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"a surface is written as {', '.join(SURFACE_FORMATS)}; {path.name!r} is none of these")
    if colours is None:
        colours = np.full((len(triangles), 3), 160, np.uint8)
    comment = "patient LPS, mm" + (f"; case {case_id}" if case_id else "")
    try:
        atomic_write(path, write(vertices_mm, normals, triangles, colours, comment))
    except OSError as error:
        raise UsageError(f"{path.name} cannot be written: {error.strerror}") from None
