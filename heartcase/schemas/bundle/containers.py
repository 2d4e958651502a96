"""What a case's files hold around its arrays: padding, the GLB's view of the surface, the header of the labels.

Read with the standard library alone: a case is checked where no viewer and no image library is installed.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open

from heartcase.schemas.arrays import Float64, Int64
from heartcase.schemas.bundle.coordinates import Coordinates
from heartcase.schemas.bundle.format import FORMAT_VERSION, VERSION_WITHOUT_SEPTA, CaseManifest, FileRole
from heartcase.schemas.bundle.manifest import stated
from heartcase.schemas.bundle.safetensors_layout import Layout
from heartcase.schemas.bundle.surface_kinds import group_labels
from heartcase.schemas.bundle.surfaces import rest_basis
from heartcase.schemas.bundle.values import Arrays, Parts
from heartcase.schemas.errors import Problem
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.strict_json import parse_json

__all__ = ["labels_problems", "render_problems", "safetensors_problems"]

GLB_JSON_MAX = 16 << 20
NRRD_HEADER_MAX = 1 << 20
NRRD_TOLERANCE_MM = 1e-3
TANGENT_TOLERANCE = 1e-3
_CHUNK = 1 << 20

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT, _UINT32 = 5126, 5125


def safetensors_problems(file: Path, role: FileRole, layout: Layout, version: str | None) -> Iterable[Problem]:
    """Holes, overlaps and unknown types that other readers refuse, and places where text could lie hidden."""
    place = f"files.{role.value}"
    try:
        with safe_open(file, framework="numpy"):
            pass
    except SafetensorError:
        yield Problem(place, "is not valid safetensors: other programs will refuse it")
    extra = layout.metadata
    is_plain = extra is None or (
        isinstance(extra, dict) and set(extra) <= {"format"} and extra.get("format", "pt") == "pt"
    )
    if not is_plain:
        yield Problem(place, "its header holds metadata: nothing but arrays belongs there")
    size = file.stat().st_size
    for name, (begin, end) in layout.others.items():
        if not re.fullmatch(r"_pad[0-9]{1,9}", name):
            if version in ("1.0", "1.1", "1.2", VERSION_WITHOUT_SEPTA, FORMAT_VERSION):
                yield Problem(place, "holds an array that the format does not have")
        elif 0 <= begin <= end <= size and _has_bytes(file, begin, end):
            yield Problem(place, "the padding between its arrays is not zero")


def _has_bytes(file: Path, begin: int, end: int) -> bool:
    with file.open("rb") as stream:
        stream.seek(begin)
        while begin < end:
            piece = stream.read(min(_CHUNK, end - begin))
            if not piece or piece.count(0) != len(piece):
                return bool(piece)
            begin += len(piece)
    return False


# ------------------------------------------------------------------------------------------------------------- labels


def labels_problems(manifest: CaseManifest, file: Path) -> Iterable[Problem]:
    """The labels must lie where the scan does, and hold labels of the table (NRRD, version 4 or 5)."""
    place = "files.labels"
    with file.open("rb") as stream:
        head = stream.read(NRRD_HEADER_MAX)
    if not head.startswith(b"NRRD"):
        yield Problem(place, "is not the kind of file that its name says")
        return
    text, end, _ = head.partition(b"\n\n")
    try:
        lines = text.decode("utf-8").splitlines()[1:]
        fields = {key.strip().lower(): value.strip() for key, mark, value in (line.partition(": ") for line in lines)}
        size = tuple(int(n) for n in fields["sizes"].split())
        origin = _vector(fields["space origin"])
        columns = np.array([_vector(part) for part in fields["space directions"].split()])
        if not end or fields["dimension"] != "3" or len(size) != 3 or columns.shape != (3, 3):
            raise ValueError
    except (ValueError, KeyError):
        yield Problem(place, "its header does not say where its voxels lie: the file is damaged")
        return
    if fields.get("space") not in ("left-posterior-superior", "LPS"):
        yield Problem(place, "is not in patient LPS space: the labels would be shown turned or mirrored")
    scan = stated(manifest, "scan_geometry")
    if isinstance(scan, Geometry):
        last = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (np.array(scan.size) - 1)
        with np.errstate(over="ignore", invalid="ignore"):
            gap = np.abs(last @ columns + origin - scan.index_to_world(last)).max()
        if size != scan.size or not gap <= NRRD_TOLERANCE_MM:
            yield Problem(place, "does not lie where scan_geometry says: the labels are mirrored, moved or others")
    yield from _voxel_problems(manifest, file, len(text) + 2, fields, size)


def _vector(text: str) -> Float64:
    found = re.fullmatch(r"\(([^()]*)\)", text)
    values = np.array([float(part) for part in found[1].split(",")] if found else [])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError
    return values


def _voxel_problems(
    manifest: CaseManifest, file: Path, begin: int, fields: dict[str, str], size: tuple[int, ...]
) -> Iterable[Problem]:
    if fields.get("type") not in ("unsigned char", "uchar", "uint8", "uint8_t") or min(size) < 1:
        return
    packed = fields.get("encoding") in ("gzip", "gz")
    if not packed and fields.get("encoding") != "raw":
        yield Problem("files.labels", "is packed in a way that the format does not have")
        return
    count, left = np.zeros(256, np.int64), size[0] * size[1] * size[2]
    unpack = zlib.decompressobj(31) if packed else None
    with file.open("rb") as stream:
        stream.seek(begin)
        try:
            while left >= 0 and (piece := stream.read(_CHUNK)):
                while piece and left >= 0:
                    # A few bytes can unpack to more than the memory holds.
                    voxels = unpack.decompress(piece, _CHUNK) if unpack else piece
                    piece = unpack.unconsumed_tail if unpack else b""
                    left -= len(voxels)
                    count += np.bincount(np.frombuffer(voxels, np.uint8), minlength=256)
        except zlib.error:
            left = -1
    if left != 0:
        yield Problem("files.labels", "does not hold as many voxels as its header says: the file is damaged")
    labels = stated(manifest, "labels.labels")
    values = {getattr(label, "value", None) for label in labels or (None,)}
    if None not in values and not set(np.flatnonzero(count).tolist()) <= values | {0}:
        yield Problem("files.labels", "holds label values that the label table does not have")


# ------------------------------------------------------------------------------------------------------------- render


def render_problems(manifest: CaseManifest, file: Path, parts: Parts) -> Iterable[Problem]:
    """The GLB must show the surface, in its place, and be read as one by any viewer (glTF 2.0)."""
    place = "files.render"
    content = file.read_bytes()
    if not content.startswith(b"glTF"):
        yield Problem(place, "is not the kind of file that its name says")
        return
    if int.from_bytes(content[8:12], "little") != len(content):
        yield Problem(place, "is cut off: its header states another length")
    try:
        document, binary = _chunks(content)
        node = _only_node(document)
        primitives = document["meshes"][node["mesh"]]["primitives"]
        attributes = [primitive["attributes"] for primitive in primitives]
        if any(one != attributes[0] for one in attributes) or any(one.get("mode", 4) != 4 for one in primitives):
            raise ValueError
        read = _Reader(document, binary)
        corners = [read(one["indices"], "SCALAR", _UINT32).reshape(-1, 3) for one in primitives]
        vertices = {
            name: read(attributes[0][name], kind, _FLOAT)
            for name, kind in (("POSITION", "VEC3"), ("NORMAL", "VEC3"), ("TANGENT", "VEC4"))
            if name in attributes[0]
        }
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        case_id = document["asset"].get("extras", {}).get("case_id")
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, struct.error):
        yield Problem(place, "its content is not the surface of a case: the file is damaged")
        return
    expected = np.eye(4)
    expected[:3, :3] = next(frame for frame in Coordinates().frames if frame.name == "gltf").from_lps_mm
    if not np.array_equal(matrix, expected):
        yield Problem(place, "is turned or mirrored: its root's matrix is not gltf_from_lps")
    if case_id is not None and case_id != stated(manifest, "case_id"):
        yield Problem(place, "is of another case: its identifier is not case_id")
    yield from _shown_problems(manifest, parts, corners, vertices)


def _shown_problems(
    manifest: CaseManifest, parts: Parts, corners: list[npt.NDArray[Any]], shown: dict[str, npt.NDArray[Any]]
) -> Iterable[Problem]:
    place, surface = "files.render", parts.get(FileRole.SURFACE, {})
    welded = surface.get("render_to_welded")
    if welded is None:
        return
    for name, key in (("POSITION", "vertices"), ("NORMAL", "normals")):
        if key in surface and not np.array_equal(shown.get(name, np.empty(0)), surface[key][welded]):
            yield Problem(place, f"its {key} are not those of the surface part")
    if any(len(some) and int(some.max()) >= len(welded) for some in corners):
        yield Problem(place, "its triangles name vertices that it does not have")
    elif {"triangles", "triangle_label", "triangle_tissue", "triangle_is_cut"} <= set(surface):
        expected = _by_kind(surface) if "triangle_kind" in surface else _by_void(surface)
        is_same = len(expected) == len(corners) and all(
            np.array_equal(_ordered(welded[some]), _ordered(want)) for some, want in zip(corners, expected, strict=True)
        )
        if not is_same:
            yield Problem(place, "its triangles are not those of the surface part, kind by kind")
    tangent, found = parts.get(FileRole.MAPPING, {}).get("tangent"), rest_basis(manifest, parts)
    if tangent is None or found is None or "TANGENT" not in shown or len(tangent) != len(welded):
        return
    rest = np.einsum("vb,vbx->vx", tangent[:, :3].astype(np.float64), found[1][welded])
    theirs = shown["TANGENT"]
    if theirs.shape != tangent.shape or not (
        np.abs(rest - theirs[:, :3]).max() <= TANGENT_TOLERANCE and np.array_equal(theirs[:, 3], tangent[:, 3])
    ):
        yield Problem("mapping.tangent", "does not give the tangents of the GLB at rest")


def _by_void(surface: Arrays) -> list[npt.NDArray[Any]]:
    """Before version 1.2: the triangles beside each void, by ascending label, then those of cut faces."""
    label, is_cut = surface["triangle_label"], surface["triangle_is_cut"] != 0
    beside = [surface["triangles"][~is_cut & (label == void)] for void in np.unique(label[~is_cut])]
    return [*beside, surface["triangles"][is_cut]] if is_cut.any() else beside


def _by_kind(surface: Arrays) -> list[npt.NDArray[Any]]:
    """The triangles of each kind, ascending, and within a kind by label where they are told apart by it."""
    kinds = surface["triangle_kind"]
    group = 256 * kinds.astype(np.int64) + group_labels(kinds, surface["triangle_label"], surface["triangle_tissue"])
    return [surface["triangles"][group == one] for one in np.unique(group)]


def _ordered(triangles: npt.NDArray[Any]) -> Int64:
    """The same triangles, each turned to begin with its lowest number, in ascending order."""
    rows = triangles.astype(np.int64)
    first = rows.argmin(axis=1)
    turned: Int64 = np.take_along_axis(rows, (first[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk of a GLB, version 2."""
    version, length, kind = struct.unpack_from("<4x I 4x II", content)
    if version != 2 or kind != _JSON or length > GLB_JSON_MAX:
        raise ValueError
    document = parse_json(content[20 : 20 + length])
    binary_length, kind = struct.unpack_from("<II", content, 20 + length)
    binary = content[28 + length : 28 + length + binary_length]
    if kind != _BINARY or len(binary) != binary_length or not isinstance(document, dict):
        raise ValueError
    return document, binary


def _only_node(document: dict[str, Any]) -> dict[str, Any]:
    """The one node of the one scene: whatever else were in it would be shown with the heart."""
    (node,), (scene,) = document["nodes"], document["scenes"]
    if scene["nodes"] != [0] or node.get("children") or len(document["meshes"]) != 1:
        raise ValueError
    found: dict[str, Any] = node
    return found


class _Reader:
    """Accessors of a GLB as arrays of their own shape."""

    def __init__(self, document: dict[str, Any], binary: bytes) -> None:
        self.document, self.binary = document, binary

    def __call__(self, number: int, kind: str, component: int) -> npt.NDArray[Any]:
        accessor = self.document["accessors"][number]
        view = self.document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[kind]
        count, start = accessor["count"], view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        is_plain = not view.get("byteStride") and not view["buffer"] and "sparse" not in accessor
        end = start + 4 * width * count
        is_inside = 0 <= view.get("byteOffset", 0) <= start <= end <= len(self.binary)
        is_inside = is_inside and end <= view.get("byteOffset", 0) + view["byteLength"]
        if (accessor["type"], accessor["componentType"]) != (kind, component) or not (is_plain and is_inside):
            raise ValueError
        values = np.frombuffer(self.binary, "<f4" if component == _FLOAT else "<u4", count * width, start)
        return values.reshape(count, width) if width > 1 else values
