"""A thousand violent scripts of each law on a backend, in several processes, and what they left.

    python -m tests.stress.many_violent_scripts cuda --jobs 6 --seconds 200 --json out/gpu/violence.json

What was run when the time is over is told, script by script in order: the laws take turns.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

SCRIPTS = 1000
SCRIPTS_AT_ONCE = 10


def run_some(law: str, seeds: range, backend: str, end: float, step_factor: float) -> list[dict[str, Any]]:
    """Outcomes of the scripts, until the time is over [s since the epoch]."""
    from tests.stress.test_violence import LAWS
    from tests.stress.violence import run

    outcomes = []
    for seed in seeds:
        if time.time() > end:
            break
        outcome: dict[str, Any] = {"law": law, "seed": seed}
        try:
            done = run(seed, LAWS[law], backend, step_factor=step_factor)
        except Exception as error:  # what breaks down is told with the rest
            outcomes.append(outcome | {"error": f"{type(error).__name__}: {error}"})
            continue
        told = {"left": done.inverted_left, "most": done.inverted_most, "settled_s": done.settled_s}
        outcomes.append(outcome | told | {"hurried": done.hurried_left, "is_finite": bool(np.isfinite(done.way_most))})
    return outcomes


def _of(law: str, part: range, done: Future[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Outcomes of a part; where its process died, one that says so."""
    try:
        return done.result()
    except Exception as error:
        return [{"law": law, "seed": part[0], "error": f"{type(error).__name__}: {error}"}]


def summary(outcomes: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the scripts of each law left."""
    laws: dict[str, dict[str, Any]] = {}
    for law in dict.fromkeys(one["law"] for one in outcomes):
        of_law = [one for one in outcomes if one["law"] == law]
        whole = [one for one in of_law if "error" not in one]
        laws[law] = {
            "scripts": len(of_law),
            "broke_down": [one for one in of_law if "error" in one or not one["is_finite"]],
            "left_cells": {one["seed"]: one["left"] for one in whole if one["left"]},
            "settled_s": max((one["settled_s"] for one in whole if not one["left"]), default=0.0),
            "at_the_limit": [one["seed"] for one in whole if one["hurried"]],
            "turned_on_the_way": sum(one["most"] for one in whole),
        }
    return laws


def main() -> None:
    """Run them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("backend", choices=("cpu", "cuda", "reference"))
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--seconds", type=float, default=3600.0, help="time after which no script is begun")
    parser.add_argument("--scripts", type=int, default=SCRIPTS, help="scripts of each law")
    parser.add_argument("--step-factor", type=float, default=1.0, help="step over the default one")
    parser.add_argument("--json", type=Path, required=True, help="file for the outcomes")
    options = parser.parse_args()
    from tests.stress.test_violence import LAWS

    begin = time.time()
    end = begin + options.seconds
    # A process that was forked after CUDA was begun has none.
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as team:
        seeds = range(options.scripts)
        parts = [seeds[first : first + SCRIPTS_AT_ONCE] for first in range(0, len(seeds), SCRIPTS_AT_ONCE)]
        of_all = (options.backend, end, options.step_factor)
        begun = [(law, part, team.submit(run_some, law, part, *of_all)) for part in parts for law in LAWS]
        outcomes = [one for law, part, done in begun for one in _of(law, part, done)]
    laws = summary(outcomes)
    told = {"backend": options.backend, "seconds": round(time.time() - begin), "laws": laws, "outcomes": outcomes}
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(told) + "\n")
    for law, one in laws.items():
        left = one["left_cells"]
        print(
            f"{law}: {one['scripts']} scripts, {len(one['broke_down'])} broke down, {len(left)} left cells inside out "
            f"(at most {max(left.values(), default=0)}), the others none after {one['settled_s']:.2f} s; "
            f"{len(one['at_the_limit'])} with nodes at the speed limit"
        )


if __name__ == "__main__":
    main()
