"""A case as one HTML file, which any browser opens from a folder or a website: looked at, pulled, recordings played.

The file holds what the studio's server would send (:mod:`heartcase.studio.operating.scene.packing`), compressed, and
the page's modules as one script. Where the browser has WebGPU, the page steps the springs by itself. In a site of
several cases (:mod:`heartcase.studio.offline.site`) the same page takes its script and its case from files beside it.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.simulator.case_simulation import DAMPING_PER_S
from heartcase.simulator.live.live_frame import LiveFrame, moment_of
from heartcase.simulator.live.shapes import CUT_FACES, Structures
from heartcase.simulator.load import Case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from heartcase.studio.offline.bundling import bundled_script
from heartcase.studio.offline.following import hung_points
from heartcase.studio.offline.shown import Shown
from heartcase.studio.offline.spring_arrays import spring_arrays
from heartcase.studio.offline.toured import Toured
from heartcase.studio.operating.scene.cell_labels import CellLabels
from heartcase.studio.operating.scene.normal_map import NormalMap
from heartcase.studio.operating.scene.packing import (
    SCALE_LEAST,
    Rounded,
    frame_message,
    packed,
    picture_message,
    topology_message,
)
from heartcase.studio.operating.viewer import described, patch_arrays

__all__ = [
    "FRAMES_PER_SECOND",
    "LINKED_POLICY",
    "PAGE",
    "Recorded",
    "case_script",
    "icons",
    "linked_page",
    "viewer_script",
    "viewer_style",
    "web_page",
]

FRAMES_PER_SECOND = 10.0
"""Pictures in a second of a recording's simulated time."""
LINKED_POLICY = (
    "default-src 'none'; script-src 'self' file: blob:; style-src 'self' file:; img-src 'self' file: data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""What a page of a site may load: files beside it. A page of a folder has no origin, so that 'self' is not enough."""
PAGE = Path(__file__).parents[1] / "page"
_STYLES = ("style.css", "operating/operate.css", "section/section.css", "offline/offline.css", "touring/touring.css")


@dataclass(frozen=True)
class Recorded:
    """A recording to be played in the page."""

    name: str
    """What it is called there."""
    moments: Iterable[LiveFrame]
    """Its moments, ``frames_per_second`` of its simulated time, from its start on."""


def web_page(
    case: Case,
    shown: Shown,
    recordings: Sequence[Recorded] = (),
    *,
    tours: Sequence[Toured] = (),
    normal_map: NormalMap | None = None,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> bytes:
    """The file of a case.

    Parameters
    ----------
    case
        The case, loaded with its surface; with ``cell_labels`` too for planes that cut it open.
    shown
        What else is shown of it, at the same level of detail.
    recordings
        Recordings of it.
    tours
        Guided tours of it.
    normal_map
        That of the surface, where the case has one.
    frames_per_second
        How many moments of a recording make a second of its simulated time.
    """
    data = _case_data(case, shown, recordings, frames_per_second, tours, normal_map)
    style, script = viewer_style(), viewer_script()
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src '{_hash_of(script)}' blob:",
            f"style-src '{_hash_of(style)}'",
            "img-src data: blob:",
        ]
    )
    return _document(
        {
            "POLICY": policy,
            "STYLE": f"<style>{style}</style>",
            "BACK": "",
            "CASE": "",
            "SCRIPT": f'<script type="text/plain" id="case-data">{data}</script>\n<script>{script}</script>',
        }
    )


def linked_page(*, style: str, script: str, case: str, back: str, back_word: str) -> bytes:
    """The page of a case in a site.

    Parameters
    ----------
    style, script
        Addresses of :func:`viewer_style` and :func:`viewer_script`, from the page.
    case
        Address of the case's :func:`case_script`.
    back, back_word
        Where its link back leads, and the word of the page that stands there.
    """
    return _document(
        {
            "POLICY": LINKED_POLICY,
            "STYLE": f'<link rel="stylesheet" href="{escape(style)}">',
            "BACK": f'<a id="back" class="button" href="{escape(back)}" data-word="{escape(back_word)}"></a>',
            "CASE": f' data-case="{escape(case)}"',
            "SCRIPT": f'<script src="{escape(script)}" defer></script>',
        }
    )


def case_script(
    case: Case,
    shown: Shown,
    recordings: Sequence[Recorded] = (),
    *,
    tours: Sequence[Toured] = (),
    normal_map: NormalMap | None = None,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> bytes:
    """A script that hands a case to a page beside it: from a folder, a browser loads scripts but no data.

    The parameters are those of :func:`web_page`.
    """
    data = _case_data(case, shown, recordings, frames_per_second, tours, normal_map)
    return f'globalThis.heartcaseData = "{data}";\n'.encode("ascii")


@cache
def viewer_script() -> str:
    """The page's modules as one script."""
    return bundled_script(PAGE, "offline/main.js")


@cache
def viewer_style() -> str:
    """The page's style."""
    return "\n".join((PAGE / name).read_text(encoding="utf-8") for name in _STYLES)


def _case_data(
    case: Case,
    shown: Shown,
    recordings: Sequence[Recorded],
    frames_per_second: float,
    tours: Sequence[Toured],
    normal_map: NormalMap | None,
) -> str:
    """What the page takes of a case, compressed, as text."""
    structures = Structures(case.manifest, shown.of_triangles)
    labels = None if case.cell_labels is None else CellLabels(case)
    start = moment_of(OperatingSession(Simulation(case.model, surface=case.surface)))
    parts = _Parts()
    drawn = _Drawn(structures, labels, normal_map)
    first = [parts.number(drawn.topology(1, start)), parts.number(_springs(case))]
    first += [parts.number(_vessel(case, shown, name)) for name in shown.vessels]
    points = [point for one in shown.landmarks for point in one["points"]]
    picture = None if normal_map is None else parts.number(picture_message(normal_map))
    hung = parts.number(packed({"kind": "landmarks"}, hung_points(case.model, points)))
    table = [
        {
            "name": recording.name,
            "parts": [parts.number(one) for one in _messages(recording.moments, drawn)],
        }
        for recording in recordings
    ]
    toured = [
        {"parts": [parts.number(part) for part in _messages(one.moments(), drawn)]} | one.as_data() for one in tours
    ]
    contents = {
        "facts": _facts(case, shown, structures, frames_per_second),
        "lengths": [len(part) for part in parts.all],
        "case": first,
        "landmarks": hung,
        "normal_map": picture,
        "recordings": table,
        "tours": toured,
    }
    head = json.dumps(contents, allow_nan=False).encode()
    data = b"".join([len(head).to_bytes(4, "little"), head, *parts.all])
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")


def _facts(case: Case, shown: Shown, structures: Structures, frames_per_second: float) -> dict[str, Any]:
    """What the page says of the case."""
    assert case.surface is not None
    model, manifest = case.model, case.manifest
    low, high = case.surface.rest_mm.min(axis=0), case.surface.rest_mm.max(axis=0)
    cut = next(one for one in structures.all if one.number == CUT_FACES)
    colour = "#{:02x}{:02x}{:02x}".format(*cut.colour)
    looks = {"colour": colour, "safe": colour, "oxygen": colour, "blood": "unknown"}
    faces = {"value": CUT_FACES, "name": cut.name, "part": "cut"} | looks
    return {
        "name": manifest.name,
        "notice": manifest.notice,
        "is_approved": shown.is_approved,
        "structures": [*shown.structures, faces],
        "landmarks": shown.landmarks,
        "inside": shown.inside,
        "axes": shown.axes,
        "oxygen": shown.oxygen,
        "box_mm": [low.tolist(), high.tolist()],
        "place": {
            "origin_mm": model.geometry.index_to_world(np.zeros(3)).tolist(),
            "direction": model.geometry.direction_matrix.tolist(),
            "cell_mm": model.cell_mm,
        },
        "frames_per_second": frames_per_second,
    }


def _springs(case: Case) -> bytes:
    arrays = spring_arrays(case.model, damping_per_s=DAMPING_PER_S)
    found = asdict(arrays)
    facts = found.pop("facts")
    return packed({"kind": "springs", "facts": facts}, found)


def _vessel(case: Case, shown: Shown, name: str) -> bytes:
    tube = shown.vessels[name]
    number = next(one["value"] for one in shown.structures if one["part"] == "vessel" and one["name"] == name)
    arrays = {"normals": tube.normals, "triangles": tube.triangles.astype(np.uint32)}
    return packed({"kind": "vessel", "structure": number}, arrays | hung_points(case.model, tube.vertices_mm))


@dataclass(frozen=True)
class _Drawn:
    """What tells how the surface of a moment is drawn."""

    structures: Structures
    labels: CellLabels | None
    normal_map: NormalMap | None

    def topology(self, number: int, moment: LiveFrame) -> bytes:
        """The surface of a moment, as a page takes it."""
        labels = None if self.labels is None else self.labels.of(moment.frame.model)
        return topology_message(number, moment, self.structures.of(moment), self.normal_map, labels)


def _messages(moments: Iterable[LiveFrame], drawn: _Drawn) -> list[bytes]:
    """Topologies and frames of some moments, as a page that has shown none of them takes them."""
    found: list[bytes] = []
    shown, sent, number = None, None, 0
    for moment in moments:
        if shown is None or moment.surface is not shown.surface or moment.frame.model is not shown.frame.model:
            number += 1
            found.append(drawn.topology(number, moment))
            if shown is None or moment.frame.model.node_count != shown.frame.model.node_count:
                sent = None
        rounded = Rounded.of(moment.frame.state.displacement, SCALE_LEAST if sent is None else sent.scale)
        header = {"frame": len(found), "topology": number} | described(moment)
        if moment.marks and (shown is None or moment.marks is not shown.marks):
            header["marks"] = moment.marks
        found.append(frame_message(header, rounded, sent, dict(patch_arrays(moment))))
        shown, sent = moment, rounded
    return found


class _Parts:
    """Messages of the file, each once."""

    def __init__(self) -> None:
        self.all: list[bytes] = []
        self._numbers: dict[bytes, int] = {}

    def number(self, part: bytes) -> int:
        """Where a message is in the file."""
        digest = hashlib.sha256(part).digest()
        if digest not in self._numbers:
            self._numbers[digest] = len(self.all)
            self.all.append(part)
        return self._numbers[digest]


@cache
def icons() -> str:
    """The drawn icons of the page that operates, as one element."""
    operate = (PAGE / "operating" / "operate.html").read_text(encoding="utf-8")
    found = re.search(r'<svg class="icons".*?</svg>', operate, re.DOTALL)
    assert found is not None
    return found[0]


def _document(parts: Mapping[str, str]) -> bytes:
    """The page with its parts put in; nothing runs in it but its own script."""
    document = (Path(__file__).parent / "offline.html").read_text(encoding="utf-8")
    parts = {"ICONS": icons(), **parts}
    return re.sub(r"<!--(\w+)-->", lambda found: parts[found[1]], document).encode("utf-8")


def _hash_of(text: str) -> str:
    """How a content security policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
