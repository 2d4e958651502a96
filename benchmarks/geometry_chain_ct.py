"""The chain of :mod:`geometry_chain` on the heart of a real CT, segmented from the strokes of its recipe.

Nobody knows the true surface, so it is asked how far the painted border between blood and muscle is from each mesh:
the middles of its voxels' faces, of which a smooth surface through them is about a fifth of a voxel away.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.chest_ct import RECIPE
from benchmarks.geometry_chain import METHODS, Inputs, Shown, soundness
from heartcase.phantom.metrics import closest_distance_mm
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.image.region import crop_scan
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.errors import UsageError
from heartcase.schemas.recipe.recipe import load_recipe

__all__ = ["METHODS", "errors", "prepare"]


def prepare(params: dict[str, Any]) -> Inputs:
    recipe = load_recipe(RECIPE)
    path = RECIPE.parent / recipe.scan.path
    if not path.exists():
        raise UsageError(f"the scan is not there: {recipe.scan.origin}", place="geometry-chain-chest-ct")
    filtered = filter_scan(crop_scan(read_scan(path), recipe.region), recipe.filter)
    markers = load_markers((), recipe.strokes, recipe.table, filtered.geometry, RECIPE.parent)
    segmentation = segment_scan(filtered, markers, recipe.segment, recipe.table)
    return Inputs(segmentation, recipe.ends, params.get("map_size", 2048), None)


def errors(inputs: Inputs, output: Shown) -> dict[str, float]:
    """Distance of the painted border between blood and muscle to the mesh, and what is wrong with the mesh."""
    labels, table, geometry = inputs.segmentation.labels, inputs.segmentation.table, inputs.segmentation.geometry
    blood, tissue = np.isin(labels, table.blood_values), np.isin(labels, table.tissue_values)
    places = []
    for axis in range(3):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        faces = np.argwhere((blood[low] & tissue[high]) | (tissue[low] & blood[high])).astype(np.float64)
        faces[:, axis] += 0.5
        places.append(geometry.index_to_world(faces[:, ::-1]))
    away = closest_distance_mm(np.concatenate(places), output.vertices_mm, output.triangles) / min(geometry.spacing_mm)
    return {
        "painted border to the mesh, mean [voxel]": float(away.mean()),
        "painted border to the mesh, 99% [voxel]": float(np.percentile(away, 99)),
        **soundness(output),
    }
