"""How long the session takes for each message of a stroke: neither socket nor page is in it.

    python -m tests.studio.page.latency --make FOLDER --size 160x200x200
    python -m tests.studio.session_frames FOLDER [--strokes 16] [--mm-per-pixel 0.55]

Strokes as ``tests.studio.page.latency`` draws them, with three planes looked at; the recipe is left as it was.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from heartcase.pipeline.building.runner import SilentListener
from heartcase.studio.painting.painting import open_painting
from heartcase.studio.painting.requests import parse_request
from tests.studio.timed_strokes import messages, planes, print_times

RESTS = 20
"""Times that the rest is asked for after a stroke, at most: the next one begins before all has come."""


class Frames:
    """One page's requests, and what each of a kind took, ms."""

    def __init__(self, painting):
        self.painting, self.page, self.took, self.number = painting, object(), {}, 0

    def ask(self, do, **said):
        self.number += 1
        start = time.perf_counter()
        answer = self.painting.do(
            parse_request(json.dumps({"id": self.number, "do": do, **said})), self.page, {self.page}
        )
        self.took.setdefault(do, []).append(1000.0 * (time.perf_counter() - start))
        return answer


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--strokes", type=int, default=16)
    parser.add_argument("--mm-per-pixel", type=float, default=0.55)
    given = parser.parse_args()
    recipe = given.folder / "session_frames.toml"
    recipe.write_text((given.folder / "latency.toml").read_text())
    painting = open_painting(recipe, out=given.folder / "out", listener=SilentListener())
    session = painting._opened.session
    frames = Frames(painting)
    middle = session.geometry.index_to_world(np.array([session.geometry.size]) // 2)[0].tolist()
    frames.ask("look", planes=planes(middle))
    names = [label.name for label in session.table]
    for stroke in range(given.strokes):
        for do, said in messages(stroke, middle, names, given.mm_per_pixel):
            frames.ask(do, **said)
        frames.ask("end")
        for _ in range(RESTS):
            if '"rest": true' not in frames.ask("rest").done:
                break
    for _ in range(given.strokes):
        frames.ask("undo")
    print_times(session.geometry.size, frames.took)
    return 0


if __name__ == "__main__":
    sys.exit(main())
