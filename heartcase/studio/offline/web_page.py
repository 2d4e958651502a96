"""A case as one HTML file, which any browser opens from a folder or a website: looked at, pulled, recordings played.

The file holds what the studio's server would send (:mod:`heartcase.studio.operating.packing`), compressed, and the
page's modules as one script. Where the browser has WebGPU, the page steps the springs by itself.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import UInt8
from heartcase.simulator.live.live import LiveFrame, moment_of
from heartcase.simulator.live.shapes import Structures
from heartcase.simulator.load import Case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.simulation import Simulation
from heartcase.studio.offline.bundling import bundled_script
from heartcase.studio.offline.spring_arrays import spring_arrays
from heartcase.studio.operating.cell_labels import CellLabels
from heartcase.studio.operating.packing import SCALE_LEAST, Rounded, frame_message, packed, topology_message
from heartcase.studio.operating.viewer import described, patch_arrays

__all__ = ["FRAMES_PER_SECOND", "Recorded", "web_page"]

FRAMES_PER_SECOND = 10.0
"""Pictures in a second of a recording's simulated time."""
_PAGE = Path(__file__).parents[1] / "page"
_STYLES = ("style.css", "operating/operate.css")
_DAMPING_PER_S = 30.0
"""Damping of all movement that the page steps, 1/s; as where the studio's server does."""


@dataclass(frozen=True)
class Recorded:
    """A recording to be played in the page."""

    name: str
    """What it is called there."""
    moments: Iterable[LiveFrame]
    """Its moments, ``frames_per_second`` of its simulated time, from its start on."""


def web_page(case: Case, recordings: Sequence[Recorded] = (), *, frames_per_second: float = FRAMES_PER_SECOND) -> bytes:
    """The file of a case.

    Parameters
    ----------
    case
        The case, loaded with its surface and structures; with ``cell_labels`` too for planes that cut it open.
    recordings
        Recordings of it.
    frames_per_second
        How many moments of a recording make a second of its simulated time.
    """
    assert case.triangle_structures is not None
    structures = Structures(case.manifest, case.triangle_structures)
    labels = None if case.cell_labels is None else CellLabels(case)
    start = moment_of(OperatingSession(Simulation(case.model, surface=case.surface)))
    parts = _Parts()
    topology = topology_message(1, start, structures.of(start), cell_labels=_of(labels, start))
    first = [parts.number(topology), parts.number(_springs(case))]
    table = [
        {
            "name": recording.name,
            "parts": [parts.number(one) for one in _messages(recording.moments, structures, labels)],
        }
        for recording in recordings
    ]
    contents = {
        "facts": _facts(case, structures, frames_per_second),
        "lengths": [len(part) for part in parts.all],
        "case": first,
        "recordings": table,
    }
    head = json.dumps(contents, allow_nan=False).encode()
    data = b"".join([len(head).to_bytes(4, "little"), head, *parts.all])
    return _document(base64.b64encode(zlib.compress(data, 9)).decode("ascii"))


def _facts(case: Case, structures: Structures, frames_per_second: float) -> dict[str, Any]:
    """What the page says of the case."""
    assert case.surface is not None
    model, manifest = case.model, case.manifest
    low, high = case.surface.rest_mm.min(axis=0), case.surface.rest_mm.max(axis=0)
    return {
        "name": manifest.name,
        "notice": manifest.notice,
        "structures": [
            {"value": one.number, "name": one.name, "colour": "#{:02x}{:02x}{:02x}".format(*one.colour)}
            for one in structures.all
        ],
        "tissue_inside": [] if case.cell_labels is None else CellLabels(case).inside(structures),
        "box_mm": [low.tolist(), high.tolist()],
        "place": {
            "origin_mm": model.geometry.index_to_world(np.zeros(3)).tolist(),
            "direction": model.geometry.direction_matrix.tolist(),
            "cell_mm": model.cell_mm,
        },
        "frames_per_second": frames_per_second,
    }


def _springs(case: Case) -> bytes:
    arrays = spring_arrays(case.model, damping_per_s=_DAMPING_PER_S)
    found = asdict(arrays)
    facts = found.pop("facts")
    return packed({"kind": "springs", "facts": facts}, found)


def _of(labels: CellLabels | None, moment: LiveFrame) -> UInt8 | None:
    return None if labels is None else labels.of(moment.frame.model)


def _messages(moments: Iterable[LiveFrame], structures: Structures, labels: CellLabels | None) -> list[bytes]:
    """Topologies and frames of some moments, as a page that has shown none of them takes them."""
    found: list[bytes] = []
    shown, sent, number = None, None, 0
    for moment in moments:
        if shown is None or moment.surface is not shown.surface or moment.frame.model is not shown.frame.model:
            number += 1
            found.append(topology_message(number, moment, structures.of(moment), cell_labels=_of(labels, moment)))
            if shown is None or moment.frame.model.node_count != shown.frame.model.node_count:
                sent = None
        rounded = Rounded.of(moment.frame.state.displacement, SCALE_LEAST if sent is None else sent.scale)
        header = {"frame": len(found), "topology": number} | described(moment)
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


def _document(data: str) -> bytes:
    """The page around the data; nothing runs in it but its own script."""
    style = "\n".join((_PAGE / name).read_text(encoding="utf-8") for name in _STYLES)
    script = bundled_script(_PAGE, "offline/main.js")
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src '{_hash_of(script)}' blob:",
            f"style-src '{_hash_of(style)}'",
            "img-src data: blob:",
        ]
    )
    document = (Path(__file__).parent / "offline.html").read_text(encoding="utf-8")
    for name, content in (("POLICY", policy), ("STYLE", style), ("SCRIPT", script), ("DATA", data)):
        before, after = document.split(f">{name}<" if name != "POLICY" else f'"{name}"')
        around = ('"', '"') if name == "POLICY" else (">", "<")
        document = f"{before}{around[0]}{content}{around[1]}{after}"
    return document.encode("utf-8")


def _hash_of(text: str) -> str:
    """How a content security policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
