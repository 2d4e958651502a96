"""All rows of ``accuracy-default`` in one go, as one table: ``python -m benchmarks.default_rows [SCAN ...]``.

The benchmark runs each method in a process of its own, because it measures time too. This measures labels alone: scans,
hearts and markers are made once for all methods. Told of each row is how far heartcase is ahead of the best peer.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.runner.cases import MethodSkipped
from benchmarks.scan_to_labels import CHEST, FLAT, KINDS, METHODS, SIZES, errors, prepare

SCANS = (*(f"{size}.{kind}" for size in SIZES for kind in KINDS), *FLAT, CHEST)
STROKES = (1, 3, 10)
SETS = 24
DICE, SPREAD = "all labels Dice [1]", "its standard error [1]"
OURS = "heartcase"
PEERS = tuple(name for name in METHODS if not name.startswith(OURS))
BEHIND = -0.01


def main(scans: Sequence[str]) -> int:
    """Print the rows of some scans, or of all, and their means; 1 where heartcase is behind in any."""
    print("| scan | strokes |", " | ".join(METHODS), "| ahead of the best peer by |")
    print("|---|---|", "---|" * (len(METHODS) + 1), sep="")
    rows: list[tuple[str, int, dict[str, float]]] = []
    for scan in scans or SCANS:
        for strokes in STROKES:
            try:
                inputs = prepare({"scan": scan, "strokes": strokes, "sets": SETS})
            except MethodSkipped as reason:
                print(f"{scan} is left out: {reason}", file=sys.stderr)
                break
            found = {name: errors(inputs, run(inputs)) for name, run in METHODS.items()}
            means = {name: one[DICE] for name, one in found.items()}
            rows.append((scan, strokes, means))
            told = [f"{one[DICE]:.3f} ± {one[SPREAD]:.3f}" for one in found.values()]
            print(f"| {scan} | {strokes} |", " | ".join(told), f"| {_ahead(means):+.3f} |", flush=True)
    for title, is_meant in (("MR", _is_mr), ("CT", _is_ct), (CHEST, CHEST.__eq__)):
        for strokes in STROKES:
            chosen = [means for scan, count, means in rows if count == strokes and is_meant(scan)]
            if chosen:
                told = [f"{np.mean([means[name] for means in chosen]):.3f}" for name in METHODS]
                print(f"| {len(chosen)} of {title} | {strokes} |", " | ".join(told), "| |")
    behind = [f"{scan} {strokes}" for scan, strokes, means in rows if _ahead(means) < BEHIND]
    print(f"{len(behind)} of {len(rows)} rows more than {-BEHIND} behind the best peer", *behind, sep="\n")
    return 1 if behind else 0


def _ahead(means: dict[str, Any]) -> float:
    return float(means[OURS] - max(means[name] for name in PEERS))


def _is_mr(scan: str) -> bool:
    return ".mr" in scan


def _is_ct(scan: str) -> bool:
    return ".ct" in scan


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
