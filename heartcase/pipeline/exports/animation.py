"""A surface in motion as one GLB file: a few shapes that are mixed, instead of a mesh for every frame.

The vertices of all frames are a matrix with a row for each frame. Its singular value decomposition gives the shapes
(morph targets of glTF 2.0) and how much of each a frame takes (its weights); shapes are added until no vertex of any
frame is further off than a tolerance (Alexa and Mueller, Computer Graphics Forum 19, 2000: principal components of an
animation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.pipeline.bundle.glb import LPS_MM_TO_GLTF, ROUGHNESS, GlbWriter, linear_colour
from heartcase.schemas.arrays import Float32, Float64, Int32, UInt8
from heartcase.schemas.errors import StageError

__all__ = ["MovingSurface", "Shapes", "animation_glb_bytes", "shapes_of"]

SHAPES_MAX = 128
"""Shapes of one surface."""


@dataclass(frozen=True)
class MovingSurface:
    """A surface whose triangles stay the same for a time; after a cut, or where something is sewn, another goes on."""

    time_s: Float64
    """Time of each frame, ascending, shape (frame_count,)."""
    vertices_mm: Float32
    """Vertices in each frame, LPS mm, shape (frame_count, vertex_count, 3)."""
    normals: Float32
    """Unit normals in each frame, LPS axes, shape (frame_count, vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, shape (triangle_count, 3)."""
    colours: UInt8
    """Red, green, blue of each triangle, shape (triangle_count, 3)."""
    until_s: float = np.inf
    """When it goes; infinity where it stays."""


@dataclass(frozen=True)
class Shapes:
    """A motion as shapes that are mixed: frame = first frame + weights @ shapes."""

    weights: Float64
    """How much of each shape each frame takes, from -1 to 1, shape (frame_count, shape_count)."""
    shapes: Float32
    """Movement of each vertex, mm, shape (shape_count, vertex_count, 3)."""
    error_mm: float
    """Furthest that a vertex is off in any frame, mm."""


def shapes_of(vertices_mm: Float32, *, tolerance_mm: float) -> Shapes:
    """As few shapes as give all frames within a tolerance.

    Parameters
    ----------
    vertices_mm
        Vertices in each frame, mm, shape (frame_count, vertex_count, 3).
    tolerance_mm
        Furthest that a vertex may be off, mm.

    Raises
    ------
    StageError
        More shapes would be needed than a viewer takes.
    """
    frame_count = len(vertices_mm)
    left = (vertices_mm - vertices_mm[0]).reshape(frame_count, -1).astype(np.float32)
    _, basis = np.linalg.eigh(left.astype(np.float64) @ left.T.astype(np.float64))
    weights: list[Float64] = []
    shapes: list[Float32] = []
    while (error := _furthest(left)) > tolerance_mm:
        if len(shapes) == min(SHAPES_MAX, frame_count):
            raise StageError(
                f"the motion is too rich: with {len(shapes)} shapes it is still {error:.3g} mm off; "
                "allow more error, or take a shorter part or fewer frames",
                place="animation",
            )
        one = basis[:, -1 - len(shapes)]
        one = one / one[np.abs(one).argmax()]
        shape = (one @ left / (one @ one)).astype(np.float32)
        left -= np.outer(one, shape).astype(np.float32)
        weights.append(one)
        shapes.append(shape)
    vertex_count = vertices_mm.shape[1]
    return Shapes(
        np.stack(weights, axis=1) if weights else np.zeros((frame_count, 0)),
        np.stack(shapes).reshape(-1, vertex_count, 3) if shapes else np.zeros((0, vertex_count, 3), np.float32),
        error,
    )


def animation_glb_bytes(
    surfaces: Sequence[MovingSurface], *, tolerance_mm: float, case_id: str | None = None
) -> tuple[bytes, float]:
    """Write surfaces in motion as GLB: each is there from its first frame until it goes.

    Parameters
    ----------
    surfaces
        At least one.
    tolerance_mm
        Furthest that a vertex may be off in a frame, mm.
    case_id
        Made-up identifier of the case, written to ``asset.extras.case_id``.

    Returns
    -------
    tuple
        The file, and how far a vertex is off at most, mm.

    Raises
    ------
    StageError
        The motion is too rich for a viewer.
    """
    writer = GlbWriter()
    begin, end = (float(which(surface.time_s[at] for surface in surfaces)) for which, at in ((min, 0), (max, -1)))
    nodes: list[dict[str, Any]] = [
        {
            "name": "patient",
            "matrix": LPS_MM_TO_GLTF.T.ravel().tolist(),
            "children": list(range(1, len(surfaces) + 1)),
        }
    ]
    meshes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    error = 0.0

    def animate(node: int, path: str, times: Float64, output: int, interpolation: str) -> None:
        at = writer.number_array(times, min=[float(np.float32(times[0]))], max=[float(np.float32(times[-1]))])
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        samplers.append({"input": at, "output": output, "interpolation": interpolation})

    for number, surface in enumerate(surfaces):
        shapes = shapes_of(surface.vertices_mm, tolerance_mm=tolerance_mm)
        error = max(error, shapes.error_mm)
        nodes.append({"name": f"surface {number + 1}", "mesh": number})
        meshes.append(_mesh(writer, surface, shapes, materials))
        if shapes.weights.size:
            output = writer.number_array(shapes.weights.ravel())
            animate(number + 1, "weights", surface.time_s - begin, output, "LINEAR")
        if surface.time_s[0] > begin or surface.until_s <= end:
            times, shown = _presence(surface, begin, end)
            scale = writer.vector_array(np.repeat(shown[:, None], 3, axis=1))
            animate(number + 1, "scale", times - begin, scale, "STEP")
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "heartcase"} | ({"extras": {"case_id": case_id}} if case_id else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
    }
    if channels:
        document["animations"] = [{"name": "recording", "channels": channels, "samplers": samplers}]
    return writer.finish(document), error


def _furthest(movement: Float32) -> float:
    """Longest of the movements of all vertices in all frames, shape (frame_count, 3 * vertex_count)."""
    return float(np.sqrt(np.square(movement.reshape(len(movement), -1, 3)).sum(axis=2).max(initial=0.0)))


def _presence(surface: MovingSurface, begin: float, end: float) -> tuple[Float64, Float64]:
    """Times at which a surface comes and goes, and whether it is there from then on, 1 or 0."""
    comes, goes = surface.time_s[0], surface.until_s
    times = np.unique(np.array([begin, comes, min(goes, end), end]))
    return times, ((times >= comes) & (times < goes)).astype(float)


def _mesh(writer: GlbWriter, surface: MovingSurface, shapes: Shapes, materials: list[dict[str, Any]]) -> dict[str, Any]:
    """The mesh of a surface: a primitive for each colour, which share vertices and shapes."""
    attributes = {
        "POSITION": _positions(writer, surface.vertices_mm[0]),
        "NORMAL": writer.vertex_array(surface.normals[0].astype("<f4"), "VEC3"),
    }
    # The normals' own share of each shape, by least squares: weights of different shapes are orthogonal.
    turned = (surface.normals - surface.normals[0]).reshape(len(surface.normals), -1)
    normals = (shapes.weights / np.square(shapes.weights).sum(axis=0)).T @ turned
    targets = [
        {
            "POSITION": _positions(writer, shape),
            "NORMAL": writer.vertex_array(normal.reshape(-1, 3).astype("<f4"), "VEC3"),
        }
        for shape, normal in zip(shapes.shapes, normals, strict=True)
    ]
    primitives = []
    for colour in np.unique(surface.colours, axis=0):
        chosen = (surface.colours == colour).all(axis=1)
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": writer.index_array(surface.triangles[chosen]),
            "material": len(materials),
        }
        primitives.append(primitive | ({"targets": targets} if targets else {}))
        materials.append(
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": linear_colour("#" + bytes(colour.tolist()).hex()),
                    "metallicFactor": 0.0,
                    "roughnessFactor": ROUGHNESS,
                }
            }
        )
    mesh: dict[str, Any] = {"name": "surface", "primitives": primitives}
    return mesh | ({"weights": [0.0] * len(targets)} if targets else {})


def _positions(writer: GlbWriter, points: Float32) -> int:
    rows = points.astype("<f4")
    return writer.vertex_array(rows, "VEC3", min=rows.min(axis=0).tolist(), max=rows.max(axis=0).tolist())
