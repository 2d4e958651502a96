"""Nearest samples of a heart's surfaces, as its distance tables ask for them: our tree beside SciPy's k-d tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy import tables
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.anatomy.nearest import SampleTree
from heartcase.schemas.arrays import Float64, Int64

COMPARED = 50
"""Queries of each surface that are compared with all its samples."""


@dataclass(frozen=True)
class Inputs:
    """Samples of each surface, and the lattice points whose nearest is asked for."""

    samples: list[Float64]
    points: list[Float64]


class _Recorder(SampleTree):
    """A tree that notes what it is asked."""

    def query(self, points: Float64) -> tuple[Float64, Int64]:
        given = np.empty_like(self.samples)
        given[self.order] = self.samples
        _RECORDED.append((given, points.copy()))
        return super().query(points)


_RECORDED: list[tuple[Float64, Float64]] = []


def prepare(params: dict[str, Any]) -> Inputs:
    _RECORDED.clear()
    tables.SampleTree = _Recorder
    try:
        _ = HeartPhantom.of_size(params["size"]).anatomy
    finally:
        tables.SampleTree = SampleTree
    return Inputs([samples for samples, _ in _RECORDED], [points for _, points in _RECORDED])


def heartcase(inputs: Inputs) -> list[Float64]:
    return [
        SampleTree.of(samples).query(points)[0] for samples, points in zip(inputs.samples, inputs.points, strict=True)
    ]


def kd_tree(inputs: Inputs) -> list[Float64]:
    """Built the quick way, as for few queries a sample; on all cores."""
    return [
        np.asarray(cKDTree(samples, compact_nodes=False, balanced_tree=False).query(points, workers=-1)[0])
        for samples, points in zip(inputs.samples, inputs.points, strict=True)
    ]


METHODS = {"heartcase": heartcase, "kd_tree": kd_tree}


def errors(inputs: Inputs, output: list[Float64]) -> dict[str, float]:
    """Largest distance from what comparing with all samples finds, of some queries."""
    worst = 0.0
    for samples, points, found in zip(inputs.samples, inputs.points, output, strict=True):
        some = np.random.default_rng(0).permutation(len(points))[:COMPARED]
        for n in some:
            true = np.sqrt(np.square(samples - points[n]).sum(axis=1).min())
            worst = max(worst, abs(float(found[n] - true)))
    return {
        "queries [million]": sum(map(len, inputs.points)) / 1e6,
        "samples [million]": sum(map(len, inputs.samples)) / 1e6,
        "largest error [mm]": worst,
    }
