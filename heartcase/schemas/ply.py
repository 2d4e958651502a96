"""A triangle surface as a binary PLY file (Greg Turk, The PLY polygon file format, 1994)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from heartcase.schemas.arrays import Float32, Int32, UInt8

__all__ = ["ply_bytes"]


def ply_bytes(
    vertices: Float32,
    normals: Float32,
    triangles: Int32,
    colours: UInt8,
    *,
    comments: Sequence[str],
    tags: Mapping[str, UInt8] | None = None,
) -> bytes:
    """Content of the file.

    Parameters
    ----------
    vertices, normals
        Places and unit normals, shape (vertex_count, 3).
    triangles
        Numbers of vertices, shape (triangle_count, 3).
    colours
        Red, green, blue of each triangle, shape (triangle_count, 3).
    comments
        Lines of ASCII text for the header.
    tags
        Other properties of the triangles, shape (triangle_count,), by their names.
    """
    tags = tags or {}
    header = "".join(
        [
            "ply\nformat binary_little_endian 1.0\n",
            *(f"comment {line}\n" for line in comments),
            f"element vertex {len(vertices)}\n",
            *(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")),
            f"element face {len(triangles)}\nproperty list uchar int vertex_indices\n",
            *(f"property uchar {name}\n" for name in ("red", "green", "blue", *tags)),
            "end_header\n",
        ]
    )
    kinds = [("count", "u1"), ("vertices", "<i4", 3), ("colour", "u1", 3), *((f"tag {name}", "u1") for name in tags)]
    face = np.zeros(len(triangles), np.dtype(kinds))
    face["count"], face["vertices"], face["colour"] = 3, triangles, colours
    for name, values in tags.items():
        face[f"tag {name}"] = values
    return header.encode("ascii") + np.hstack([vertices, normals]).astype("<f4").tobytes() + face.tobytes()
