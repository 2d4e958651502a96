"""One more stroke on a segmented scan, until the labels are there: mended, solved anew on the tree, or flooded anew.

The strokes are such as a person paints: short lines anywhere in the scan, with the true label of their place; the first
ones on the phantom's own markers. A run is one stroke, so the time is the median of a stroke.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skimage.segmentation import watershed

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, Stroke

REPEATS = {"heartcase": 300, "anew": 20, "skimage": 2}
STROKE_LENGTH_MM = 10.0


@dataclass(frozen=True)
class Inputs:
    """A session with the phantom's markers, and the strokes to come."""

    source: PhantomInputs
    tree: BasinTree
    session: SegmentationSession
    strokes: list[Stroke]
    milliseconds: list[float] = field(default_factory=list)


def prepare(params: dict[str, Any]) -> Inputs:
    """``noise_floor``: as in the recipe; with one most strokes lie in what is flat."""
    settings = SegmentSettings(noise_floor=params.pop("noise_floor", None))
    source = phantom_inputs(params)
    filtered = filter_scan(source.scan, FilterSettings())
    tree = scan_tree(filtered, settings)
    session = SegmentationSession(tree, filtered.geometry, source.phantom.table, markers=source.markers)
    return Inputs(source, tree, session, _strokes(source, max(REPEATS.values()) + 1))


def _strokes(source: PhantomInputs, count: int) -> list[Stroke]:
    random = np.random.default_rng(1)
    geometry, truth, table = source.truth.geometry, bare_truth(source), source.phantom.table
    strokes = []
    while len(strokes) < count:
        start = geometry.index_to_world(random.uniform(0.0, np.array(geometry.size) - 1.0))
        way = random.normal(size=3)
        line = start + np.linspace(0.0, STROKE_LENGTH_MM, 11)[:, None] * way / np.linalg.norm(way)
        index = np.rint(geometry.world_to_index(line)).astype(int)
        if not ((index >= 0) & (index < np.array(geometry.size))).all():
            continue
        labels = truth[index[:, 2], index[:, 1], index[:, 0]]
        if (labels != labels[0]).any():
            continue
        ends = tuple(tuple(float(x) for x in point) for point in line[[0, -1]])
        strokes.append(Stroke(label=table[int(labels[0])].name, radius_mm=1.5, points_mm=ends))
    return strokes


def heartcase(inputs: Inputs) -> SegmentationSession:
    stroke = inputs.strokes[len(inputs.session.strokes)]
    start = time.perf_counter()
    inputs.session.paint(stroke)
    inputs.milliseconds.append(1e3 * (time.perf_counter() - start))
    return inputs.session


def anew(inputs: Inputs) -> SegmentationSession:
    """All markers solved on the tree, which is there already."""
    solve_forest(inputs.tree, inputs.session.markers().labels)
    return inputs.session


def skimage(inputs: Inputs) -> SegmentationSession:
    """All markers flooded."""
    markers = inputs.session.markers().labels
    watershed(inputs.tree.height, np.where(markers == UNMARKED, 0, markers.astype(np.int32) + 1))
    return inputs.session


METHODS = {"heartcase": heartcase, "anew": anew, "skimage": skimage}


def errors(inputs: Inputs, output: SegmentationSession) -> dict[str, float]:
    """Voxels unlike a fresh solution of the same markers, and the times of what else is done in a session."""
    if not inputs.milliseconds:
        return {"voxels [million]": output.labels.size / 1e6}
    times = np.array(inputs.milliseconds[1:])

    def worst_ms(deeds: list[Any]) -> float:
        worst = 0.0
        for deed in deeds:
            start = time.perf_counter()
            deed()
            worst = max(worst, 1e3 * (time.perf_counter() - start))
        return worst

    fresh = solve_forest(inputs.tree, output.markers().labels).labels
    found = {
        "voxels unlike a fresh solution [1]": float((fresh != output.labels).sum()),
        "95% of the strokes within [ms]": float(np.percentile(times, 95)),
        "slowest stroke [ms]": float(times.max()),
        "undo, slowest of 10 [ms]": worst_ms([output.undo] * 10),
        "redo, slowest of 10 [ms]": worst_ms([output.redo] * 10),
    }
    erasers = [Stroke(erase=True, radius_mm=3.0, points_mm=stroke.points_mm) for stroke in inputs.strokes[:10]]
    found["erase, slowest of 10 [ms]"] = worst_ms([lambda s=s: output.paint(s) for s in erasers])
    fresh = solve_forest(inputs.tree, output.markers().labels).labels
    found["voxels unlike a fresh solution, after all [1]"] = float((fresh != output.labels).sum())
    return found
