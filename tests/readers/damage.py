"""Ways in which a copy of a case can be damaged, each with what the readers must say of it."""

from __future__ import annotations

import hashlib
import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["DAMAGES", "CaseCopy", "Damage"]

_LETTERS = {"I32": "i", "I16": "h", "F32": "f", "U8": "B"}


class CaseCopy:
    """A copy of a case that is to be damaged; unless told otherwise sizes and hashes are made to agree again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: dict[str, Any] = json.loads((folder / "case.json").read_text())

    def entry(self, role: str) -> dict[str, Any]:
        found: dict[str, Any] = next(entry for entry in self.manifest["files"] if entry["role"] == role)
        return found

    def path(self, role: str) -> Path:
        return self.folder / self.entry(role)["name"]

    def save(self) -> None:
        (self.folder / "case.json").write_text(json.dumps(self.manifest))

    def write(self, role: str, content: bytes) -> None:
        """Replace a file, and say so in the manifest."""
        self.path(role).write_bytes(content)
        self.entry(role).update(size=len(content), sha256=hashlib.sha256(content).hexdigest())
        self.save()

    def header(self, role: str) -> tuple[dict[str, Any], bytes]:
        content = self.path(role).read_bytes()
        length = int.from_bytes(content[:8], "little")
        return json.loads(content[8 : 8 + length]), content[8 + length :]

    def write_header(self, role: str, header: object, data: bytes) -> None:
        """Replace a file's header by one of the same length where it can be, so that offsets still hold."""
        old = int.from_bytes(self.path(role).read_bytes()[:8], "little")
        text = (header if isinstance(header, str) else json.dumps(header, separators=(",", ":"))).encode().ljust(old)
        self.write(role, len(text).to_bytes(8, "little") + text + data)

    def values(self, role: str, name: str) -> list[Any]:
        header, data = self.header(role)
        begin, end = header[name]["data_offsets"]
        letter = _LETTERS[header[name]["dtype"]]
        return list(struct.unpack(f"<{(end - begin) // struct.calcsize(letter)}{letter}", data[begin:end]))

    def set_values(self, role: str, name: str, values: list[Any]) -> None:
        header, data = self.header(role)
        begin, end = header[name]["data_offsets"]
        packed = struct.pack(f"<{len(values)}{_LETTERS[header[name]['dtype']]}", *values)
        assert len(packed) == end - begin
        self.write_header(role, header, data[:begin] + packed + data[end:])


@dataclass(frozen=True)
class Damage:
    """One way to damage a case."""

    name: str
    apply: Callable[[CaseCopy], None]
    says: str
    """Part of the line that both readers print."""
    is_seen_by_heartcase: bool = True
    """Whether ``heartcase validate`` refuses it too."""


def _manifest(name: str, says: str, change: Callable[[dict[str, Any]], object], *, seen: bool = True) -> Damage:
    def apply(case: CaseCopy) -> None:
        change(case.manifest)
        case.save()

    return Damage(name, apply, says, seen)


def _text(name: str, says: str, change: Callable[[bytes], bytes], *, seen: bool = True) -> Damage:
    def apply(case: CaseCopy) -> None:
        file = case.folder / "case.json"
        file.write_bytes(change(file.read_bytes()))

    return Damage(name, apply, says, seen)


def _raw(name: str, role: str, says: str, change: Callable[[bytes], bytes]) -> Damage:
    """A file is changed and the manifest is not."""

    def apply(case: CaseCopy) -> None:
        case.path(role).write_bytes(change(case.path(role).read_bytes()))

    return Damage(f"{name}-{role}", apply, says)


def _file(name: str, role: str, says: str, change: Callable[[bytes], bytes]) -> Damage:
    """A file is changed and the manifest agrees."""
    return Damage(f"{name}-{role}", lambda case: case.write(role, change(case.path(role).read_bytes())), says)


def _header(name: str, says: str, change: Callable[[dict[str, Any]], object], role: str = "grid") -> Damage:
    def apply(case: CaseCopy) -> None:
        header, data = case.header(role)
        change(header)
        case.write_header(role, header, data)

    return Damage(name, apply, says)


def _value(role: str, array: str, value: float, says: str, *, at: int = 0, seen: bool = True) -> Damage:
    def apply(case: CaseCopy) -> None:
        values = case.values(role, array)
        values[at] = value
        case.set_values(role, array, values)

    return Damage(f"{role}.{array}={value}", apply, says, seen)


def _values(
    name: str, role: str, array: str, says: str, change: Callable[[list[Any]], list[Any]], *, seen: bool = True
) -> Damage:
    return Damage(name, lambda case: case.set_values(role, array, change(case.values(role, array))), says, seen)


def _flip(content: bytes, at: int) -> bytes:
    changed = bytearray(content)
    changed[at] ^= 0x10
    return bytes(changed)


def _escape(case: CaseCopy) -> None:
    outside = case.folder.parent / "outside.safetensors"
    outside.write_bytes(case.path("grid").read_bytes())
    case.entry("grid")["name"] = "../outside.safetensors"
    case.save()


def _link(case: CaseCopy) -> None:
    outside = case.folder.parent / "outside.safetensors"
    case.path("grid").rename(outside)
    case.path("grid").symlink_to(outside)


def _link_manifest(case: CaseCopy) -> None:
    outside = case.folder.parent / "outside.json"
    (case.folder / "case.json").rename(outside)
    (case.folder / "case.json").symlink_to(outside)


def _in_quality(value: bytes) -> Callable[[bytes], bytes]:
    """A value where anything may stand; and the text must hold it then."""
    return lambda text: text.replace(b'"quality": {}', b'"quality": {"a": ' + value + b"}", 1)


def _swap_header_size(size: int) -> Callable[[bytes], bytes]:
    return lambda content: size.to_bytes(8, "little") + content[8:]


def _mirror_landmarks(manifest: dict[str, Any]) -> None:
    for mark in manifest["landmarks"]:
        mark["points_mm"] = [[-x, y, z] for x, y, z in mark["points_mm"]]


def _file_entry(manifest: dict[str, Any], role: str = "grid") -> dict[str, Any]:
    found: dict[str, Any] = next(entry for entry in manifest["files"] if entry["role"] == role)
    return found


def _frame(manifest: dict[str, Any], name: str) -> dict[str, Any]:
    found: dict[str, Any] = next(frame for frame in manifest["coordinates"]["frames"] if frame["name"] == name)
    return found


def _flip_direction(manifest: dict[str, Any]) -> None:
    rows = manifest["grid_geometry"]["direction"]
    manifest["grid_geometry"]["direction"] = [[-a, b, c] for a, b, c in rows]


def _mirror_x(values: list[float]) -> list[float]:
    return [-v if n % 3 == 0 else v for n, v in enumerate(values)]


def _turn(values: list[int]) -> list[int]:
    return [values[n + (0, 1, -1)[n % 3]] for n in range(len(values))]


def _swap_rows(values: list[int]) -> list[int]:
    return values[3:6] + values[:3] + values[6:]


_ARRAY_ROLES = ("grid", "surface", "mapping", "picking", "scan")
_VERSION = "MAJOR.MINOR"

DAMAGES: tuple[Damage, ...] = (
    # The text of the manifest
    _text("manifest-cut", "not valid JSON", lambda text: text[: len(text) // 2]),
    _text("manifest-empty", "not valid JSON", lambda _: b""),
    _text("manifest-twice", "not valid JSON", lambda text: text + text),
    _text("manifest-list", "lacks", lambda text: b"[" + text + b"]"),
    _text("manifest-deep", "case.json", lambda _: b"[" * 100_000 + b"]" * 100_000),
    _text("manifest-large", "larger than allowed", lambda text: text + b" " * (16 << 20)),
    _text("manifest-not-utf8", "not valid JSON", lambda text: text.replace(b'"name"', b'"n\xe4me"', 1)),
    _text("manifest-nan", "not valid JSON", lambda text: text.replace(b'"cell_mm": 4.0', b'"cell_mm": NaN')),
    _text("manifest-infinite", "out of range", lambda text: text.replace(b'"cell_mm": 4.0', b'"cell_mm": 1e999')),
    _text("manifest-key-twice", "same key twice", lambda text: text.replace(b"{", b'{"format": 1,', 1)),
    _text("quality-nan", "not valid JSON", _in_quality(b"NaN")),
    _text("quality-infinite", "out of range", _in_quality(b"[1e999]")),
    _text("quality-long-number", "out of range", _in_quality(b"1" * 400)),
    _text("quality-deep", "too deep", _in_quality(b"[" * 63 + b"]" * 63)),
    _text("quality-half-character", "case.json", _in_quality(b'"\\ud800"')),
    _text("manifest-utf-16", "not valid JSON", lambda text: text.decode().encode("utf-16")),
    _text("manifest-byte-order-mark", "not valid JSON", lambda text: b"\xef\xbb\xbf" + text),
    Damage("manifest-is-a-link", _link_manifest, "no plain file"),
    Damage("manifest-missing", lambda case: (case.folder / "case.json").unlink(), "case.json is missing"),
    # What the manifest says
    _manifest("other-format", "not a heartcase bundle", lambda m: m.update(format="other")),
    _manifest("major-version-2", "does not know", lambda m: m.update(format_version="2.0")),
    _manifest("major-version-01", "does not know", lambda m: m.update(format_version="01.1")),
    _manifest("version-without-minor", _VERSION, lambda m: m.update(format_version="1")),
    _manifest("version-number", "format_version", lambda m: m.update(format_version=1.1)),
    _manifest("required-extension", "extension", lambda m: m.update(required_extensions=["heartcase_beating"])),
    _manifest("name-absolute", "plain file name", lambda m: _file_entry(m).update(name="/etc/passwd")),
    _manifest("name-backslash", "plain file name", lambda m: _file_entry(m).update(name="..\\x")),
    _manifest("name-empty", "plain file name", lambda m: _file_entry(m).update(name="")),
    Damage("name-climbs-out", _escape, "plain file name"),
    _manifest(
        "name-of-a-newer-role",
        "plain file name",
        lambda m: (
            m.update(format_version="1.9"),
            m["files"].append({"role": "valves", "name": "../v", "size": 3, "sha256": "0" * 64}),
        ),
    ),
    _manifest("role-twice", "role of an entry before", lambda m: m["files"].append({**_file_entry(m), "name": "a"})),
    _manifest("no-grid", "no grid file", lambda m: m["files"].remove(_file_entry(m))),
    _manifest(
        "no-surface", "surface file was not read", lambda m: m["files"].remove(_file_entry(m, "surface")), seen=False
    ),
    _manifest("size-wrong", "size that case.json states", lambda m: _file_entry(m).update(size=10**9)),
    _manifest("size-negative", "size", lambda m: _file_entry(m).update(size=-1)),
    _manifest("hash-wrong", "SHA-256", lambda m: _file_entry(m).update(sha256="0" * 64)),
    _manifest("hash-short", "sha256", lambda m: _file_entry(m).update(sha256="0" * 63)),
    _manifest("direction-mirrored", "mirrored", _flip_direction),
    _manifest("direction-sheared", "unit and square", lambda m: m["grid_geometry"]["direction"][0].reverse()),
    _manifest("spacing-zero", "not positive", lambda m: m["grid_geometry"].update(spacing_mm=[0, 4, 4])),
    _manifest("cells-not-cubes", "not cubes", lambda m: m["grid_geometry"].update(spacing_mm=[4, 4, 5])),
    _manifest("cell-of-other-size", "cell_mm", lambda m: m["simulation"].update(cell_mm=5.0)),
    _manifest("grid-too-small", "outside the grid", lambda m: m["grid_geometry"].update(size=[1, 1, 1])),
    _manifest("step-too-long", "step_default_s", lambda m: m["simulation"].update(step_default_s=1.0)),
    _manifest("node-count", "that case.json counts", lambda m: m["simulation"].update(node_count=80)),
    _manifest("fixed-count", "nodes fixed", lambda m: m["simulation"].update(fixed_node_count=1)),
    _manifest("material-missing", "has a material", lambda m: m["materials"].pop()),
    _manifest("label-missing", "label", lambda m: m["labels"]["labels"].pop()),
    _manifest("gltf-mirrored", "mirrored", lambda m: m["gltf_from_lps"][2].__setitem__(1, 0.001)),
    _manifest("unity-mirrored", "mirrored", lambda m: _frame(m, "unity").update(from_lps_mm=[[1, 0, 0]] * 3)),
    _manifest("unity-turned", "wrong way", lambda m: _frame(m, "unity").update(reverse_triangles=False)),
    _manifest("coordinates-missing", "coordinates", lambda m: m.pop("coordinates")),
    _manifest("direction-missing", "direction", lambda m: m["grid_geometry"].pop("direction")),
    _manifest("axes-ras", "not allow", lambda m: m["coordinates"].update(space="patient RAS")),
    _manifest("axes-turned", "not allow", lambda m: m["coordinates"]["axes"].reverse()),
    _manifest("winding-turned", "not allow", lambda m: m["coordinates"].update(winding="clockwise")),
    _manifest("unreal-right-handed", "handedness", lambda m: _frame(m, "unreal").update(handedness="right")),
    _manifest("landmarks-mirrored", "mirrored", _mirror_landmarks, seen=False),
    _manifest("table-missing", "leaves out", lambda m: _file_entry(m)["arrays"].pop()),
    _manifest("table-offset", "does not agree", lambda m: _file_entry(m)["arrays"][1].update(offset=64)),
    _manifest("table-type", "does not agree", lambda m: _file_entry(m)["arrays"][0].update(dtype="float32")),
    _manifest("table-shape", "does not agree", lambda m: _file_entry(m)["arrays"][0]["shape"].reverse()),
    _manifest("scan-values-missing", "scan_values", lambda m: m.update(scan_values=None)),
    _manifest("scan-shape", "shape of scan_geometry", lambda m: m["scan_geometry"]["size"].reverse()),
    # Files that are not what the manifest says
    *(_raw("last-byte", role, "SHA-256", lambda c: _flip(c, -1)) for role in (*_ARRAY_ROLES, "render")),
    *(_raw("header-byte", role, "SHA-256", lambda c: _flip(c, 40)) for role in _ARRAY_ROLES),
    *(_raw("cut", role, "size that case.json states", lambda c: c[:-1]) for role in (*_ARRAY_ROLES, "render")),
    Damage("file-missing", lambda case: case.path("surface").unlink(), "is missing"),
    Damage("file-is-a-link", _link, "no plain file"),
    # Files that are wrong though size and hash agree
    *(_file("cut-agreed", role, "outside its file", lambda c: c[:-1]) for role in _ARRAY_ROLES),
    _file("longer", "grid", "no array holds", lambda c: c + b"\0"),
    _file("empty", "grid", "too short", lambda _: b""),
    _file("header-huge", "grid", "header longer", _swap_header_size(2**64 - 1)),
    _file("header-signed", "mapping", "header longer", _swap_header_size(2**63)),
    _file("header-4-gib", "grid", "header longer", _swap_header_size(2**32)),
    _file("header-past-end", "surface", "header longer", lambda c: _swap_header_size(len(c) - 7)(c)),
    _file("header-short", "picking", "not valid JSON", _swap_header_size(20)),
    Damage("header-list", lambda c: c.write_header("grid", "[]", c.header("grid")[1]), "not an object"),
    Damage("header-deep", lambda c: c.write_header("grid", "[" * 999 + "]" * 999, b""), "header"),
    _header("array-missing", "no array holds", lambda h: h.pop("fixed")),
    _header("array-renamed", "fixed is missing", lambda h: h.update(foxed=h.pop("fixed"))),
    _header("type-unknown", "type that is not known", lambda h: h["cells"].update(dtype="C64")),
    _header("type-wrong", "cells has the wrong type", lambda h: h["cells"].update(dtype="F32")),
    _header("shape-flat", "cells has the wrong shape", lambda h: h["cells"].update(shape=[75])),
    _header("shape-turned", "cells has the wrong shape", lambda h: h["cells"]["shape"].reverse()),
    _header("shape-negative", "shape that is not one", lambda h: h["cells"].update(shape=[-25, -3])),
    _header("shape-broken", "shape that is not one", lambda h: h["cells"].update(shape=[25.5, 3])),
    _header("shape-overflow", "header ", lambda h: h["cells"].update(shape=[2**32, 2**32, 2**32, 2**32])),
    _header("offsets-none", "data_offsets", lambda h: h["cells"].update(data_offsets=[])),
    _header("offset-negative", "data_offsets", lambda h: h["cells"].update(data_offsets=[-300, 0])),
    _header("offset-huge", "outside", lambda h: h["cells"].update(data_offsets=[2**52, 2**52 + 300])),
    _header("offset-backward", "outside", lambda h: h["cells"]["data_offsets"].reverse()),
    _header("arrays-overlap", "overlap", lambda h: h["fixed"].update(data_offsets=[0, 81])),
    # Values
    _value("grid", "cells", -1, "outside the grid"),
    _value("grid", "cells", 2**31 - 1, "outside the grid"),
    _value("grid", "nodes", 3, "nodes"),
    _values("cells-not-in-order", "grid", "cells", "ascend", _swap_rows),
    _values("nodes-not-in-order", "grid", "nodes", "ascend", _swap_rows),
    _value("grid", "cell_coverage", 0.0, "cell_coverage"),
    _value("grid", "cell_coverage", 1.5, "cell_coverage"),
    _value("grid", "cell_coverage", math.nan, "cell_coverage"),
    _value("grid", "cell_stiffness", math.inf, "cell_stiffness"),
    _value("grid", "cell_density", -1.0, "cell_density", at=7),
    _value("grid", "cell_moments", 0.6, "cell_moments must be from", at=6),
    _value("grid", "cell_moments", math.nan, "cell_moments must be from", at=8),
    _value("grid", "cell_moments", 0.4, "below the squares of the means in row 1", at=0),
    _value("grid", "cell_label", 200, "cell_label"),
    _value("grid", "fixed", 2, "fixed"),
    _values("all-fixed", "grid", "fixed", "node", lambda values: [1] * len(values)),
    _value("surface", "triangles", 158, "triangles"),
    _value("surface", "triangles", -1, "triangles", at=8),
    _value("surface", "render_to_welded", 158, "render_to_welded"),
    _value("surface", "triangle_label", 99, "triangle_label"),
    _value("surface", "vertices", math.nan, "vertices"),
    _values("surface-mirrored", "surface", "vertices", "surface at rest", _mirror_x),
    _values("triangles-turned", "surface", "triangles", "inside out", _turn),
    _value("mapping", "triangle_nodes", 81, "triangle_nodes", at=5),
    _value("mapping", "triangle_nodes", -(2**31), "triangle_nodes"),
    _value("mapping", "weights", 2.0, "weights"),
    _value("mapping", "offset", math.inf, "offset"),
    _value("mapping", "offset", 3.0, "surface at rest", at=1),
    _value("mapping", "curvature", 2, "curvature"),
    _value("mapping", "nearest_node", 81, "nearest_node"),
    _value("mapping", "tangent", math.nan, "tangent"),
    _value("picking", "nodes", 81, "nodes"),
    _value("picking", "triangles", 80, "triangles"),
)
