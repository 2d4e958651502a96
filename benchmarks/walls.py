"""Distance fields and grown walls, from a segmentation of the noisy scan or from the true labels.

The thickness is measured on the finished surface, between the wall's outer and the cavity's own surface, and compared
with the true one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from phantom_inputs import PhantomInputs, bare_truth, phantom_inputs

from heartcase.phantom.metrics import wall_thickness_errors
from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.filter import filter_scan
from heartcase.pipeline.segment import segment_scan
from heartcase.pipeline.surface import build_surface
from heartcase.pipeline.walls import grow_walls
from heartcase.schemas.settings import FilterSettings, SegmentSettings, SurfaceSettings, WallsSettings


@dataclass(frozen=True)
class Inputs:
    """Cavities and myocardium, no grown walls."""

    source: PhantomInputs
    segmentation: Segmentation


def prepare(params: dict[str, Any]) -> Inputs:
    labels_from = params.pop("labels_from")
    source = phantom_inputs(params)
    if labels_from == "segmentation":
        filtered = filter_scan(source.scan, FilterSettings())
        return Inputs(source, segment_scan(filtered, source.markers, SegmentSettings(), source.phantom.table))
    return Inputs(source, Segmentation(bare_truth(source), source.truth.geometry, source.phantom.table))


def heartcase(inputs: Inputs) -> Structures:
    return grow_walls(inputs.segmentation, WallsSettings(), inputs.source.phantom.ends)


METHODS = {"heartcase": heartcase}


def errors(inputs: Inputs, output: Structures) -> dict[str, float]:
    """Thickness of each wall between its inner and its outer surface, against the true thickness."""
    surface = build_surface(output, SurfaceSettings(triangle_count=200_000), render=False)
    walls = wall_thickness_errors(
        surface.vertices_mm, surface.triangles, surface.triangle_label, surface.triangle_tissue, output.table
    )
    found = {}
    for name, error in walls.items():
        found[f"{name} thickness, mean [mm]"] = error.mean_mm
        found[f"{name} thickness, 95% [mm]"] = error.percentile_95_mm
    every = [error.mean_mm for error in walls.values()]
    return {"all walls, mean [mm]": float(np.mean(every))} | found
