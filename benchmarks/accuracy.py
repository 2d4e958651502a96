"""Segmentations from few to many strokes: ours beside other programs' methods, given the same markers.

Every method gets the filtered scan (or its gradient) and the same painted voxels. What it finds is compared with the
phantom's exact shapes. Behind the end discs, where the truth says that the vessels end though the scan goes on, all
labels are cleared first, for every method alike. Grown walls are background: nobody paints them.
"""

from __future__ import annotations

import io
import math
import tempfile
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, code_key, phantom_inputs
from benchmarks.runner.cases import MethodSkipped
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.strokes import first_strokes, marker_strokes
from heartcase.phantom.metrics import SurfaceError, closest_distance_mm, dice, label_surface
from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.gradient import gradient_magnitude
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.files import atomic_write
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, Stroke

POOL = "blood pool"
MUSCLE = "left ventricular myocardium"
CONTOUR_STEP_MM = 1.0
"""Lattice on which the adult's true surfaces are contoured: 0.02 mm off on the tightest smooth curve (8 mm)."""
WALKER_BETA = 1e4
"""Random walker: penalty on intensity steps, for values scaled to -1..1. The best of 130 to 300,000 at 2.5 mm with
three strokes a label; its default of 130 finds next to nothing here."""
WALKER_VOXELS_MAX = 300_000
"""Random walker: larger scans would make it most of the time of the whole table."""


@dataclass(frozen=True)
class Inputs:
    """A filtered scan with its markers, and what is true of it."""

    filtered: Scan
    markers: Markers
    table: LabelTable
    true_labels: Any
    behind_ends: Any
    size: str
    walker_voxels_max: int


def prepare(params: dict[str, Any]) -> Inputs:
    """Inputs for ``strokes`` strokes a label (0: the whole set of long ones) beside what ``phantom_inputs`` takes."""
    count = params.pop("strokes")
    walker_voxels_max = params.pop("walker_voxels_max", WALKER_VOXELS_MAX)
    key = tuple((name, tuple(value) if isinstance(value, list) else value) for name, value in sorted(params.items()))
    source, filtered, behind = _scan(key)
    strokes = _strokes(source.phantom.size, count)
    markers = load_markers((), strokes, source.phantom.table, filtered.geometry, Path())
    return Inputs(
        filtered, markers, source.phantom.table, bare_truth(source), behind, source.phantom.size, walker_voxels_max
    )


@cache
def _scan(key: tuple[tuple[str, Any], ...]) -> tuple[PhantomInputs, Scan, Any]:
    source = phantom_inputs(dict(key))
    return source, filter_scan(source.scan, FilterSettings()), behind_ends(source.phantom, source.scan.geometry)


@cache
def _strokes(size: str, count: int) -> tuple[Stroke, ...]:
    phantom = HeartPhantom.of_size(size)
    return first_strokes(phantom, count) if count else marker_strokes(phantom)


def behind_ends(phantom: HeartPhantom, geometry: Geometry) -> Any:
    """Voxels behind an end disc, where the scan goes on and the truth does not."""
    points = geometry.index_to_world(np.indices(geometry.shape).reshape(3, -1)[::-1].T)
    behind = np.zeros(len(points), bool)
    for end in phantom.ends:
        axis = np.array(end.axis) / np.linalg.norm(end.axis)
        away = points - np.array(end.position_mm)
        along = away @ axis
        across = np.linalg.norm(away - along[:, None] * axis, axis=1)
        behind |= (along > 0.0) & (along < phantom.truth.reach_mm) & (across < end.radius_mm)
    return behind.reshape(geometry.shape)


def heartcase(inputs: Inputs) -> Segmentation:
    return segment_scan(inputs.filtered, inputs.markers, SegmentSettings(), inputs.table)


def skimage(inputs: Inputs) -> Segmentation:
    """The textbook watershed of scikit-image on the same gradient."""
    from skimage.segmentation import watershed

    gradient = gradient_magnitude(inputs.filtered.values, inputs.filtered.geometry.spacing_mm)
    return _segmentation(inputs, watershed(gradient, _seeds(inputs)))


def growcut(inputs: Inputs) -> Segmentation:
    """FastGrowCut (Zhu, Kolesov, Gao, Kikinis and Tannenbaum, 2014) with its defaults: 3D Slicer's Grow from seeds."""
    try:
        import itk

        kernel = itk.FastGrowCut
    except (ImportError, AttributeError):
        raise MethodSkipped("it needs itk-growcut: pip install '.[bench]'") from None
    spacing = list(inputs.filtered.geometry.spacing_mm)
    image = itk.image_from_array(inputs.filtered.values)
    seeds = itk.image_from_array(_seeds(inputs).astype(np.uint8))
    image.SetSpacing(spacing)
    seeds.SetSpacing(spacing)
    grown = kernel[type(image), type(seeds)].New()
    grown.SetInput(image)
    grown.SetSeedImage(seeds)
    grown.Update()
    return _segmentation(inputs, itk.array_from_image(grown.GetOutput()))


def randomwalker(inputs: Inputs) -> Segmentation:
    """Grady's random walker (2006) of scikit-image, by conjugate gradients."""
    from skimage.segmentation import random_walker

    voxel_count = inputs.filtered.values.size
    if voxel_count > inputs.walker_voxels_max:
        raise MethodSkipped(
            f"{voxel_count / 1e6:.1f} million voxels would be most of the whole run; the limit is "
            f"{inputs.walker_voxels_max / 1e6:.1f} million (walker_voxels_max)",
        )
    values = inputs.filtered.values.astype(np.float64)
    values = 2.0 * (values - values.min()) / np.ptp(values) - 1.0
    seeds = _seeds(inputs)
    # It numbers its labels anew where a number in between is missing.
    present = np.unique(seeds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # It warns of probabilities that rounding takes past 1.
        found = random_walker(
            values,
            np.searchsorted(present, seeds),
            beta=WALKER_BETA,
            mode="cg_j",
            tol=1e-3,
            spacing=np.array(inputs.filtered.geometry.spacing_mm[::-1]),
        )
    return _segmentation(inputs, present[np.maximum(found, 0)])


METHODS = {"heartcase": heartcase, "skimage": skimage, "growcut": growcut, "randomwalker": randomwalker}


def _seeds(inputs: Inputs) -> Any:
    """Marked voxels as label + 1, the others 0."""
    seeds = inputs.markers.labels.astype(np.int32) + 1
    seeds[inputs.markers.labels == UNMARKED] = 0
    return seeds


def _segmentation(inputs: Inputs, found: Any) -> Segmentation:
    """Back from label + 1; what a method leaves undecided is background."""
    labels = np.maximum(np.asarray(found).astype(np.int32) - 1, 0).astype(np.uint8)
    return Segmentation(labels, inputs.filtered.geometry, inputs.table)


def errors(inputs: Inputs, output: Segmentation) -> dict[str, float]:
    """Dice, 95% Hausdorff and mean surface distance of the pool, the left myocardium and all labels."""
    labels = np.where(inputs.behind_ends, 0, output.labels).astype(np.uint8)
    truth, table = inputs.true_labels, inputs.table
    groups: dict[str, tuple[int, ...]] = {POOL: table.blood_values}
    groups |= {label.name: (label.value,) for label in table if label.value}
    surfaces = true_surfaces(inputs.size)
    overlap = {name: dice(labels, truth, values) for name, values in groups.items()}
    distance = {
        name: surface_distance(np.isin(labels, values).astype(np.uint8), output.geometry, *surfaces[name])
        for name, values in groups.items()
    }
    names = [name for name in groups if name != POOL]
    muscle = table[MUSCLE].name
    # A structure that was lost is as far off as the scan is long.
    worst_mm = float(np.linalg.norm(np.array(output.geometry.size) * output.geometry.spacing_mm))

    def mm(value: float) -> float:
        return value if math.isfinite(value) else worst_mm

    found: dict[str, float] = {}
    for title, name in ((POOL, POOL), ("left myocardium", muscle)):
        found[f"{title} Dice [1]"] = overlap[name]
        found[f"{title} 95% distance [mm]"] = mm(distance[name].percentile_95_mm)
        found[f"{title} mean distance [mm]"] = mm(distance[name].mean_mm)
    for title, best, worst in (("all labels", np.mean, np.mean), ("worst label", min, max)):
        found[f"{title} Dice [1]"] = float(best([overlap[name] for name in names]))
        found[f"{title} 95% distance [mm]"] = float(worst([mm(distance[name].percentile_95_mm) for name in names]))
        found[f"{title} mean distance [mm]"] = float(worst([mm(distance[name].mean_mm) for name in names]))
    found |= {f"{name} Dice [1]": overlap[name] for name in names if name != muscle}
    found["voxels marked [%]"] = 100.0 * float((inputs.markers.labels != UNMARKED).mean())
    return found


def surface_distance(mask: Any, geometry: Geometry, vertices_mm: Any, triangles: Any) -> SurfaceError:
    """Distances both ways between the border of a mask (uint8, 1 inside) and a triangle mesh, vertex to surface."""
    own_mm, own = label_surface(mask, geometry, 1)
    if not len(own_mm):
        return SurfaceError.of([])
    there = closest_distance_mm(own_mm, vertices_mm, triangles)
    back = closest_distance_mm(vertices_mm, own_mm, own)
    return SurfaceError.of(np.concatenate([there, back]))


@cache
def true_surfaces(size: str) -> dict[str, tuple[Any, Any]]:
    """Vertices, mm, and triangles of the true border of the blood pool and of every label, kept between runs."""
    key = code_key({"surfaces": size, "step_mm": CONTOUR_STEP_MM})
    path = Path(tempfile.gettempdir()) / "heartcase-benchmark-inputs" / f"surfaces-{key}.npz"
    if path.is_file():
        with np.load(path) as kept:
            names = [name[:-2] for name in kept.files if name.endswith(" v")]
            return {name: (kept[f"{name} v"], kept[f"{name} t"]) for name in names}
    made = contoured_truth(HeartPhantom.of_size(size))
    arrays = {f"{name} {kind}": part for name, both in made.items() for kind, part in zip("vt", both, strict=True)}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, stream.getvalue())
    return made


def contoured_truth(phantom: HeartPhantom) -> dict[str, tuple[Any, Any]]:
    """The zero sets of the truth's own values, by marching cubes on a lattice finer than any scan here."""
    from skimage.measure import marching_cubes

    geometry = phantom.scan_geometry(CONTOUR_STEP_MM * phantom.scale / 0.93, margin_mm=5.0)
    points = geometry.index_to_world(np.indices(geometry.shape).reshape(3, -1)[::-1].T)
    pool = np.full(geometry.shape, np.inf)
    found = {}
    for label in phantom.table:
        if label.value == 0:
            continue
        value = phantom.truth.value(points, label.value).reshape(geometry.shape)
        if label.value in phantom.table.blood_values:
            pool = np.minimum(pool, value)
        found[label.name] = _contour(value, geometry, marching_cubes)
    return {POOL: _contour(pool, geometry, marching_cubes)} | found


def _contour(value: Any, geometry: Geometry, marching_cubes: Any) -> tuple[Any, Any]:
    vertices, triangles, _, _ = marching_cubes(value, 0.0)
    return geometry.index_to_world(vertices[:, ::-1].astype(np.float64)), triangles.astype(np.int64)
