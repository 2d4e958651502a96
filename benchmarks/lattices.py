"""Lattices of a heart for the engine's cases.

They come from the phantom, through the pipeline. A GPU machine need not have the pipeline: write them on one that has,

    python -m benchmarks.lattices out/lattices

and name that folder in ``HEARTCASE_LATTICES`` on the other.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.runner.cases import MethodSkipped
from heartcase.simulator.lattice.model import LatticeModel, make_model

NODE_COUNTS = (10_000, 20_000, 30_000, 60_000, 100_000, 250_000)
"""What is written for other machines."""
SCAN = {"size": "adult", "spacing_mm": 1.75}


def heart_lattice(node_count: int, split: int = 1, scale: float = 1.0) -> LatticeModel:
    """The adult phantom's tissue at about ``node_count`` nodes, scaled, and every cell then cut into ``split``^3."""
    arrays = _stored(node_count) or _made(node_count)
    cells, coverage = arrays["cells"].astype(np.int32), arrays["coverage"]
    if split > 1:
        part = np.stack(np.meshgrid(*[np.arange(split, dtype=np.int32)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        cells = (cells[:, None] * split + part).reshape(-1, 3)
        coverage = np.repeat(coverage, len(part))
    fixed: Any = arrays["fixed"] if split == 1 else False
    return make_model(cells, coverage=coverage, fixed=fixed, cell_mm=float(arrays["cell_mm"]) * scale / split)


def _stored(node_count: int) -> dict[str, Any] | None:
    folder = os.environ.get("HEARTCASE_LATTICES")
    path = Path(folder or ".") / f"adult-{node_count}.npz"
    if folder is None or not path.exists():
        return None
    with np.load(path) as arrays:
        return dict(arrays)


def _made(node_count: int) -> dict[str, Any]:
    try:
        from benchmarks.geometry import prepare as prepare_geometry
        from heartcase.pipeline.cells.build_grid import build_grid
        from heartcase.schemas.recipe.settings import GridSettings
    except ImportError:
        raise MethodSkipped("it needs the extra [prepare], or HEARTCASE_LATTICES (see benchmarks.lattices)") from None
    structures = prepare_geometry(SCAN | {"stage": "grid"}).structures
    grid = build_grid(structures, GridSettings(node_count=node_count))
    return {
        "cells": grid.cells,
        "coverage": grid.cell_coverage,
        "fixed": grid.fixed,
        "cell_mm": np.float64(grid.geometry.spacing_mm[0]),
    }


def main() -> None:
    """Write the lattices to a folder."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for node_count in NODE_COUNTS:
        arrays = _made(node_count)
        arrays["cells"] = arrays["cells"].astype(np.int16)
        np.savez_compressed(folder / f"adult-{node_count}.npz", **arrays)
        print(f"{node_count}: {len(arrays['cells'])} cells of {arrays['cell_mm']:.2f} mm")


if __name__ == "__main__":
    main()
