"""The surface as one GLB file (glTF 2.0): a view for any viewer, with the same bytes for the same surface."""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

from heartcase.pipeline.data import Surface
from heartcase.schemas.arrays import Float, Int32
from heartcase.schemas.bundle.surface_kinds import SurfaceKind, group_labels
from heartcase.schemas.labels import Label, LabelTable, Role

__all__ = ["LPS_MM_TO_GLTF", "ROUGHNESS", "GlbWriter", "glb_bytes", "linear_colour", "normal_map_png"]

LPS_MM_TO_GLTF = np.array(
    [[0.001, 0.0, 0.0, 0.0], [0.0, 0.0, 0.001, 0.0], [0.0, -0.001, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Patient LPS in mm to metres with Y up: (x, y, z) -> (x, z, -y) / 1000; the front of the patient faces the viewer."""

OUTSIDE_TERMS = ("morphologically left ventricular myocardium", "myocardium")
TISSUE_COLOUR = Label(value=1, name="myocardium", role=Role.MYOCARDIUM).colour
FIXED_LOOKS = {
    SurfaceKind.DEFECT_RIM: ("defect rim", "#f2b01e"),
    SurfaceKind.CUT_FACE: ("cut face", "#e3b5a4"),
}
"""Name and colour of kinds that look the same beside every structure."""
ROUGHNESS = 0.6

FLOAT, UINT32 = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
LINEAR, LINEAR_MIPMAP_LINEAR, CLAMP_TO_EDGE = 9729, 9987, 33071


def glb_bytes(surface: Surface, *, case_id: str | None = None, png: bytes | None = None) -> bytes:
    """Write a surface as GLB.

    One mesh under a root node that turns patient millimetres into metres with Y up. One primitive for each kind of
    triangle, ascending, of chambers and vessels one for each label; all share the same vertex arrays. Where the
    surface has a normal map, it is embedded with texture coordinates and tangents.

    Parameters
    ----------
    surface
        The surface; GLB vertices are its render vertices in their order.
    case_id
        Made-up identifier of the case, written to ``asset.extras.case_id``.
    png
        The surface's :func:`normal_map_png` where it is made already.

    Returns
    -------
    bytes
        The file.
    """
    writer = GlbWriter()
    has_map = surface.normal_map.size > 0
    welded = surface.render_to_welded
    position = surface.vertices_mm[welded].astype("<f4")
    bounds = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    attributes = {
        "POSITION": writer.vertex_array(position, "VEC3", **bounds),
        "NORMAL": writer.vertex_array(surface.normals[welded].astype("<f4"), "VEC3"),
    }
    material: dict[str, Any] = {}
    document: dict[str, Any] = {}
    if has_map:
        attributes["TANGENT"] = writer.vertex_array(surface.render_tangents.astype("<f4"), "VEC4")
        attributes["TEXCOORD_0"] = writer.vertex_array(surface.render_uv.astype("<f4"), "VEC2")
        document["samplers"] = [
            {"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}
        ]
        document["textures"] = [{"sampler": 0, "source": 0}]
        material["normalTexture"] = {"index": 0}
    materials: list[dict[str, Any]] = []
    group = group_labels(surface.triangle_kind, surface.triangle_label, surface.triangle_tissue)
    primitives = []
    # one number for both: rows are sorted slowly
    keys = surface.triangle_kind.astype(np.int64) << 8 | group
    for key in np.unique(keys).tolist():
        kind, label = key >> 8, key & 0xFF
        chosen = keys == key
        name, colour = _look(surface.table, SurfaceKind(kind), label)
        primitives.append((name, colour, surface.render_triangles[chosen]))
    gltf_primitives = []
    for name, colour, triangles in primitives:
        materials.append(
            {
                "name": name,
                "pbrMetallicRoughness": {
                    "baseColorFactor": linear_colour(colour),
                    "metallicFactor": 0.0,
                    "roughnessFactor": ROUGHNESS,
                },
                **material,
            }
        )
        gltf_primitives.append(
            {"attributes": attributes, "indices": writer.index_array(triangles), "material": len(materials) - 1}
        )
    if has_map:
        view = writer.view(normal_map_png(surface) if png is None else png)
        document["images"] = [{"name": "normal map", "mimeType": "image/png", "bufferView": view}]
    document |= {
        "asset": {"version": "2.0", "generator": "heartcase"} | ({"extras": {"case_id": case_id}} if case_id else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "patient", "matrix": LPS_MM_TO_GLTF.T.ravel().tolist(), "mesh": 0}],
        "meshes": [{"name": "surface", "primitives": gltf_primitives}],
        "materials": materials,
    }
    return writer.finish(document)


class GlbWriter:
    """Collects arrays into one binary chunk, each at a multiple of four bytes, and puts the file together."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, data: bytes, target: int | None = None) -> int:
        """Number of the view of some bytes."""
        self.data += b"\0" * (-len(self.data) % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.data += data
        return len(self.views) - 1

    def vertex_array(self, array: Float, kind: str, **more: Any) -> int:
        """Number of the accessor of a float32 array with a row for each vertex."""
        view = self.view(array.tobytes(), ARRAY_BUFFER)
        self.accessors.append({"bufferView": view, "componentType": FLOAT, "count": len(array), "type": kind, **more})
        return len(self.accessors) - 1

    def index_array(self, triangles: Int32) -> int:
        """Number of the accessor of triangles."""
        view = self.view(triangles.astype("<u4").tobytes(), ELEMENT_ARRAY_BUFFER)
        self.accessors.append(
            {"bufferView": view, "componentType": UINT32, "count": int(triangles.size), "type": "SCALAR"}
        )
        return len(self.accessors) - 1

    def vector_array(self, array: Float) -> int:
        """Number of the accessor of float32 vectors that are no vertices, shape (count, 3): places of an animation."""
        view = self.view(array.astype("<f4").tobytes())
        self.accessors.append({"bufferView": view, "componentType": FLOAT, "count": len(array), "type": "VEC3"})
        return len(self.accessors) - 1

    def number_array(self, array: Float, **more: Any) -> int:
        """Number of the accessor of float32 numbers that are no vertices: times and weights of an animation."""
        view = self.view(array.astype("<f4").tobytes())
        self.accessors.append(
            {"bufferView": view, "componentType": FLOAT, "count": int(array.size), "type": "SCALAR", **more}
        )
        return len(self.accessors) - 1

    def finish(self, document: dict[str, Any]) -> bytes:
        """The file, of a document without its arrays."""
        self.data += b"\0" * (-len(self.data) % 4)
        document |= {
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
        }
        text = json.dumps(document, separators=(",", ":"), sort_keys=True).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(self.data)
        header = struct.pack("<4sII", b"glTF", 2, total)
        return b"".join(
            [
                header,
                struct.pack("<I4s", len(text), b"JSON"),
                text,
                struct.pack("<I4s", len(self.data), b"BIN\0"),
                bytes(self.data),
            ]
        )


def _look(table: LabelTable, kind: SurfaceKind, label: int) -> tuple[str, str]:
    """Name and colour of a primitive; the epicardium looks as the left ventricle's muscle, in any order of labels."""
    if kind in FIXED_LOOKS:
        return FIXED_LOOKS[kind]
    if kind is not SurfaceKind.EPICARDIUM:
        return table[label].name, table[label].colour
    tissue = [entry for entry in table if entry.role is Role.MYOCARDIUM and entry.wall_of is None]
    tissue.sort(key=lambda entry: entry.term is None or entry.term.name not in OUTSIDE_TERMS)
    return "epicardium", tissue[0].colour if tissue else TISSUE_COLOUR


def linear_colour(colour: str) -> list[float]:
    """An sRGB colour as linear red, green, blue, alpha (IEC 61966-2-1)."""
    channels = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return [round(c, 6) for c in linear] + [1.0]


def normal_map_png(surface: Surface) -> bytes:
    """The normal map as a PNG file; empty where there is none."""
    if surface.normal_map.size == 0:
        return b""
    stream = io.BytesIO()
    Image.fromarray(surface.normal_map).save(stream, format="PNG", compress_level=6)
    return stream.getvalue()
