"""How far the noise floor of a CT may go: where it lies over a weak border, the label on one side takes the other side.

On the real CT the myocardium lies on the liver without much of a border. Many sets of strokes of its two recipes are
solved, and those are counted whose myocardium reaches the faces of the region, which it does nowhere in truth. So it
needs no label that anybody painted as the truth.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import Any

import cc3d
import numpy as np

from benchmarks.runner.cases import MethodSkipped
from benchmarks.scan_to_labels import CHEST, RECIPE, Inputs
from benchmarks.scan_to_labels import prepare as prepared
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.arrays import UInt8
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings

QUICK = RECIPE.with_name("chest_ct_few_strokes.toml")
MYOCARDIUM = "morphologically left ventricular myocardium"
LEFT_OUT = 6
"""Of the quick strokes every sixth is left out at random."""
REACHES_CM2 = 5.0
"""From so much area at the faces on a set counts."""


@dataclass(frozen=True)
class Sets:
    """A scan with many sets of markers, and the settings to try."""

    inputs: Inputs
    settings: SegmentSettings


def prepare(params: dict[str, Any]) -> Sets:
    """``sets`` sets of each of three kinds, over ``noise_floor``."""
    count = params["sets"]
    inputs = prepared({"scan": CHEST, "strokes": 3, "sets": count})
    ten = prepared({"scan": CHEST, "strokes": 10, "sets": count})
    markers = (*inputs.marker_sets, *ten.marker_sets, *_quick(count))
    return Sets(dataclasses.replace(inputs, marker_sets=markers), SegmentSettings(noise_floor=params["noise_floor"]))


@cache
def _quick(count: int) -> tuple[UInt8, ...]:
    """The quick strokes without every sixth: connected components of what they mark."""
    recipe = load_recipe(QUICK)
    geometry = prepared({"scan": CHEST, "strokes": 3, "sets": 1}).scan.geometry
    if recipe.region != load_recipe(RECIPE).region:
        raise MethodSkipped("the two recipes have other regions")
    marks = load_markers((), recipe.strokes, recipe.table, geometry, QUICK.parent).labels
    component = cc3d.connected_components(np.where(marks == UNMARKED, 0, marks + np.int32(1)))
    names = np.arange(1, component.max() + 1)
    random = np.random.Generator(np.random.PCG64(0))
    dropped = [random.choice(names, len(names) // LEFT_OUT, replace=False) for _ in range(count)]
    return tuple(np.where(np.isin(component, drop), np.uint8(UNMARKED), marks) for drop in dropped)


def heartcase(sets: Sets) -> tuple[UInt8, ...]:
    return _solved(sets, FilterSettings())


def heartcase_other(sets: Sets) -> tuple[UInt8, ...]:
    """Behind the filter that is not the default of a CT."""
    return _solved(sets, FilterSettings(method="gradient_diffusion"))


def _solved(sets: Sets, filter_settings: FilterSettings) -> tuple[UInt8, ...]:
    tree = scan_tree(filter_scan(sets.inputs.scan, filter_settings), sets.settings)
    return tuple(solve_forest(tree, markers).labels for markers in sets.inputs.marker_sets)


METHODS = {"heartcase": heartcase, "heartcase_other": heartcase_other}


def errors(sets: Sets, output: tuple[UInt8, ...]) -> dict[str, float]:
    """Of each kind of strokes, in how many sets the myocardium reaches the faces."""
    value = sets.inputs.table[MYOCARDIUM].value
    spacing = np.array(sets.inputs.scan.geometry.spacing_mm[::-1])
    reached = np.zeros(len(output))
    for n, labels in enumerate(output):
        for axis in range(3):
            face_cm2 = np.delete(spacing, axis).prod() / 100.0
            reached[n] += face_cm2 * sum(np.count_nonzero(np.take(labels, side, axis) == value) for side in (0, -1))
    third = len(output) // 3
    leaks = (reached > REACHES_CM2).reshape(3, third).sum(axis=1)
    kinds = ("three strokes a label", "ten strokes a label", "quick strokes without a sixth")
    return {"sets of each kind [1]": float(third)} | {
        f"of {kind}, myocardium at the faces in [1]": float(one) for kind, one in zip(kinds, leaks, strict=True)
    }
