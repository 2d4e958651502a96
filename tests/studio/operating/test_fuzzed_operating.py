"""Random messages of pages that operate, sensible and not: the server answers each, lives, and can begin anew."""

from __future__ import annotations

import json
from random import Random

import numpy as np
import pytest

from tests.studio.fuzzed import damaged
from tests.studio.operating.performing import UP, operator

GARBAGE = (
    "",
    "null",
    "[]",
    "{",
    '{"id": 1}',
    '{"do": "press"}',
    '{"id": -1, "do": "undo"}',
    "\ud800",
    '{"do": "seen"}',
)


TOUR = """\
+++
heartcase_tour = 1
case = "block"
+++
# A block

## Look

At it.

## Pull

```toml
[[do]]
kind = "close_grab"
name = "its hand"
center_mm = [22.0, -14.0, 40.5]

[[do]]
kind = "lead_grab"
name = "its hand"
offset_mm = { towards = "above", by_mm = 2 }

[[do]]
kind = "wait"
seconds = 0.02
```

It follows.

## Let go

```toml
[[do]]
kind = "open_grab"
name = "its hand"
```

And goes back.
"""


def anything(random):
    """A request, mostly a sensible one."""
    x, y = random.uniform(5.0, 36.0), random.uniform(-25.0, -3.0)
    far = random.choice([1.0, 1.0, 1.0, 1e12, 1e300], p=[0.4, 0.3, 0.2, 0.05, 0.05])
    pointer = {"start_mm": [far * x, y, 120.0], "direction": [0.05 * far * random.normal(), 0, -1]} | UP
    what = random.choice(
        [
            "take",
            "press",
            "drag",
            "drag",
            "release",
            "wheel",
            "resize",
            "let_go",
            "along",
            "run",
            "play",
            "go_to",
            "hide",
            "cut_open",
            "slice",
            "tour",
        ]
    )
    match what:
        case "take":
            return {"do": "take", "tool": str(random.choice([*"gpcfrsne", "", "q"]))}
        case "press" | "drag" | "release":
            return {"do": str(what), "pointer": pointer}
        case "wheel":
            return {"do": "wheel", "notches": int(random.integers(-5, 6))}
        case "resize":
            return {"do": "resize", "steps": int(random.integers(-4, 5))}
        case "let_go":
            return {
                "do": "let_go",
                "pointer": pointer if random.random() < 0.5 else None,
                "everything": random.random() < 0.2,
            }
        case "along":
            return {"do": str(random.choice(["undo", "redo", "back", "put_down", "tie"]))}
        case "run":
            return {"do": "pause", "paused": bool(random.random() < 0.3)}
        case "play":
            do = str(random.choice(["play", "record", "stop_recording", "recordings"]))
            return {"do": do} | ({"speed": float(random.choice([-1.0, 0.25, 4.0]))} if do == "play" else {})
        case "go_to":
            return {"do": "command", "command": {"kind": "go_to", "step": int(random.integers(0, 3000))}}
        case "cut_open":
            plane = {"normal": random.normal(size=3).tolist(), "point_mm": [x, y, far * 36.0]}
            return {"do": "cut_open", "plane": plane if random.random() < 0.8 else None}
        case "tour":
            step = None if random.random() < 0.2 else int(random.integers(0, 4))
            asked = {"do": "tour", "tour": int(random.integers(0, 2)), "step": step}
            return asked if random.random() < 0.7 else {"do": "tours"}
        case "slice":
            name = str(random.choice(["cut", "axial"]))
            return {"do": "slice", "name": name, "point_mm": [x, y, far], "right": [1, 0, 0], "down": [0, 0.6, -0.8]}
        case _:
            return {"do": "hide", "structures": random.integers(0, 257, 3).tolist()}


def play_through(browser, opened, seeds, length):
    theatre = opened.places["operating"]
    (theatre._case.parent / "block.tour.md").write_text(TOUR)
    for seed in seeds:
        random = np.random.default_rng(seed)
        with operator(browser, opened) as page:
            for _ in range(length):
                request = anything(random)
                if random.random() < 0.2:
                    text = damaged(Random(int(random.integers(1 << 30))), request)
                    page.socket.send_text(text.encode("utf-8", "replace").decode())
                    answer = page.hear("done", "refused")
                else:
                    answer = page.ask(**request)
                    assert answer["id"] == page.number
                assert answer["kind"] == "done" or answer["problems"]
                assert "unforeseen" not in json.dumps(answer), (seed, request, answer)
            assert theatre._stage.live.error is None
            page.done("begin")
            page.until(lambda frame: frame["act_count"] == 0 and not frame["instruments"])
            # it moves again
            page.done("take", tool="g")
            page.done("hide", structures=[])
            page.done("cut_open", plane=None)
            assert page.at("press", (22.0, -14.0, 40.5))["used"]
            page.until(lambda frame: bool(frame["instruments"]))
            page.at("release", (22.0, -14.0, 40.5))
            page.done("begin")
            page.until(lambda frame: frame["act_count"] == 0)


def test_some_random_messages(operated):
    play_through(*operated, range(4), 40)


@pytest.mark.slow
def test_a_thousand_random_sequences(operated):
    play_through(*operated, range(100, 1100), 25)
