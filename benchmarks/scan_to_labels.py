"""From scan to labels with default settings, filter included: ours beside what users of SimpleITK and scikit-image do.

One set of few strokes is one chance: which thin wall is missed by a stroke decides more than any filter. So every
figure is the mean over several sets, the same for all methods: on phantoms the ordered strokes of ``first_strokes`` and
random ones, on the real CT random ones of its recipe.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from skimage.segmentation import watershed

from benchmarks.accuracy import behind_ends
from benchmarks.phantom_inputs import bare_truth, phantom_inputs
from benchmarks.runner.cases import MethodSkipped
from heartcase.phantom.drawing.strokes import first_strokes, random_strokes
from heartcase.phantom.metrics import dice
from heartcase.pipeline.data import UNMARKED, Scan
from heartcase.pipeline.formats.read_scan import read_labels, read_scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.region import crop_scan
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, Stroke

sitk.ProcessObject.SetGlobalWarningDisplay(False)

RECIPE = Path(__file__).parents[1] / "sample_cases" / "chest_ct.toml"
CHEST = "chest"
SIZES: dict[str, dict[str, Any]] = {
    "infant": {"size": "child"},
    "child": {"body_surface_m2": 0.6},
    "adult": {"size": "adult"},
}
MRI_MM = {"infant": 1.25, "child": 1.75, "adult": 2.5}
CT_MM = {"infant": 1.0, "child": 1.5, "adult": 2.0}
KINDS: dict[str, dict[str, Any]] = {
    "mr": {"modality": "mri", "noise": 14.5},
    "mrhalf": {"modality": "mri", "noise": 7.25},
    "ct": {"modality": "ct", "noise": 8.0, "texture": True},
    "cthalf": {"modality": "ct", "noise": 4.0, "texture": True},
    "ctstreaks": {"modality": "ct", "noise": 8.0, "texture": True, "contrast_hu": 900.0},
}
"""Contrast to noise as usual and half of it. The noise of a CT is shared between neighbours, as a kernel leaves it."""
FLAT: dict[str, dict[str, Any]] = {
    "adult.mrflat": {"spacing_mm": [2.4, 2.6, 3.0]},
    "adult.mrshortaxis": {"spacing_mm": [1.4, 1.4, 8.0], "oblique": True},
}
ITERATIONS = 5
CONDUCTANCE = {"gradient": 1.0, "curvature": 3.0}
"""SimpleITK's usual ones: its own default, and that of its examples for the curvature filter."""


@dataclass(frozen=True)
class Inputs:
    """A scan, several sets of markers, and what is true of it."""

    scan: Scan
    marker_sets: tuple[Any, ...]
    table: LabelTable
    truth: Any
    left_out: Any
    values: tuple[int, ...]
    """Label values that the truth knows."""


def prepare(params: dict[str, Any]) -> Inputs:
    """``scan`` is ``chest`` or size, dot and kind; ``strokes`` a label in each of ``sets`` sets."""
    name, count, sets = params["scan"], params["strokes"], params["sets"]
    if name == CHEST:
        return _chest(count, sets)
    size, kind = name.split(".")
    seed = params.get("seed", 11)
    if name in FLAT:
        settings = KINDS["mr"] | SIZES[size] | FLAT[name]
    else:
        settings = KINDS[kind] | SIZES[size] | {"spacing_mm": (MRI_MM if kind.startswith("mr") else CT_MM)[size]}
    source = phantom_inputs(settings | {"seed": seed})
    phantom, geometry = source.phantom, source.scan.geometry
    chosen = [first_strokes(phantom, count), *(random_strokes(phantom, count, n) for n in range(1, sets))]
    markers = tuple(_markers(strokes, phantom.table, geometry) for strokes in chosen)
    values = tuple(value for value in np.unique(bare_truth(source)).tolist() if value)
    return Inputs(source.scan, markers, phantom.table, bare_truth(source), behind_ends(phantom, geometry), values)


def _markers(strokes: tuple[Stroke, ...], table: LabelTable, geometry: Geometry) -> Any:
    """Markers of the strokes that reach into the scan: some around a heart of another form lie outside."""
    last = np.array(geometry.size) - 1
    inside = []
    for stroke in strokes:
        index = geometry.world_to_index(np.array(stroke.points_mm))
        if np.all((index >= 0) & (index <= last), axis=1).any():
            inside.append(stroke)
    return load_markers((), tuple(inside), table, geometry, Path()).labels


@cache
def _chest(count: int, sets: int) -> Inputs:
    recipe = load_recipe(RECIPE)
    path = RECIPE.parent / recipe.scan.path
    if not path.exists():
        raise MethodSkipped(f"the scan is not there: {recipe.scan.origin}")
    scan = dataclasses.replace(crop_scan(read_scan(path), recipe.region), modality="CT")
    given = read_labels(path.with_name("pulmonary_artery.nii.gz"))
    artery = crop_scan(Scan((given.values > 0).astype(np.float32), given.geometry), recipe.region).values > 0.5
    value = recipe.table["pulmonary artery"].value
    strokes = defaultdict(list)
    for stroke in recipe.strokes:
        strokes[stroke.label].append(stroke)
    markers = []
    for n in range(sets):
        generator = np.random.Generator(np.random.PCG64([n, count]))
        chosen = [
            of_label[i] for of_label in strokes.values() for i in sorted(generator.permutation(len(of_label))[:count])
        ]
        markers.append(_markers(tuple(chosen), recipe.table, scan.geometry))
    truth = np.where(artery, value, 0).astype(np.uint8)
    return Inputs(scan, tuple(markers), recipe.table, truth, np.zeros(truth.shape, bool), (value,))


def heartcase(inputs: Inputs) -> tuple[Any, ...]:
    return _ours(inputs, FilterSettings(), SegmentSettings())


def heartcase_other(inputs: Inputs) -> tuple[Any, ...]:
    """The same behind the filter that is not the default for this modality."""
    is_ct = inputs.scan.modality == "CT"
    other = FilterSettings(method="gradient_diffusion" if is_ct else "curvature_diffusion")
    return _ours(inputs, other, SegmentSettings())


def heartcase_no_floor(inputs: Inputs) -> tuple[Any, ...]:
    """The watershed alone, without the part below a floor where ways add up."""
    return _ours(inputs, FilterSettings(), SegmentSettings(noise_floor=0.0))


def _ours(inputs: Inputs, filter_settings: FilterSettings, settings: SegmentSettings) -> tuple[Any, ...]:
    tree = scan_tree(filter_scan(inputs.scan, filter_settings), settings)
    return tuple(solve_forest(tree, markers).labels for markers in inputs.marker_sets)


def _peer(inputs: Inputs, kind: str, *, is_blurred: bool) -> tuple[Any, ...]:
    """SimpleITK's diffusion and gradient, scikit-image's watershed of it."""
    spacing = inputs.scan.geometry.spacing_mm
    image = sitk.GetImageFromArray(inputs.scan.values)
    image.SetSpacing(spacing)
    diffuse = sitk.GradientAnisotropicDiffusion if kind == "gradient" else sitk.CurvatureAnisotropicDiffusion
    smoothed = diffuse(
        image,
        # its filter's own limit
        timeStep=min(0.0625, min(spacing) / 16.0),
        conductanceParameter=CONDUCTANCE[kind],
        numberOfIterations=ITERATIONS,
    )
    if is_blurred:
        gradient = sitk.GradientMagnitudeRecursiveGaussian(smoothed, min(spacing))
    else:
        gradient = sitk.GradientMagnitude(smoothed)
    height = sitk.GetArrayFromImage(gradient)
    found = []
    for markers in inputs.marker_sets:
        seeds = markers.astype(np.int32) + 1
        seeds[markers == UNMARKED] = 0
        found.append((watershed(height, seeds) - 1).astype(np.uint8))
    return tuple(found)


def _named(kind: str, *, is_blurred: bool) -> Callable[[Inputs], tuple[Any, ...]]:
    return lambda inputs: _peer(inputs, kind, is_blurred=is_blurred)


METHODS = {
    "heartcase": heartcase,
    "heartcase_other": heartcase_other,
    "heartcase_no_floor": heartcase_no_floor,
    "gradient": _named("gradient", is_blurred=False),
    "gradient_blurred": _named("gradient", is_blurred=True),
    "curvature": _named("curvature", is_blurred=False),
    "curvature_blurred": _named("curvature", is_blurred=True),
}


def errors(inputs: Inputs, output: tuple[Any, ...]) -> dict[str, float]:
    """Dice over all labels that the truth has, and of each, means over the sets of markers."""
    by_label = np.array(
        [
            [dice(np.where(inputs.left_out, 0, labels), inputs.truth, value) for value in inputs.values]
            for labels in output
        ]
    )
    names = [inputs.table[value].name for value in inputs.values]
    of_each = {f"{name} Dice [1]": float(mean) for name, mean in zip(names, by_label.mean(axis=0), strict=True)}
    of_set = by_label.mean(axis=1)
    spread = float(of_set.std(ddof=1) / np.sqrt(len(of_set))) if len(of_set) > 1 else float("nan")
    return {"all labels Dice [1]": float(of_set.mean()), "its standard error [1]": spread, **of_each}
