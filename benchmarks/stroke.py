"""One more stroke on a segmented scan: from the stroke to the labels. So far both start anew from all markers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import segment
from phantom_inputs import phantom_inputs

from heartcase.phantom.metrics import dice
from heartcase.phantom.strokes import marker_strokes
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.markers import load_markers
from heartcase.schemas.settings import Stroke


@dataclass(frozen=True)
class Inputs:
    """What a segmentation needs, and the strokes with the added one at their end."""

    scan: segment.Inputs
    strokes: tuple[Stroke, ...]


def prepare(params: dict[str, Any]) -> Inputs:
    return Inputs(segment.prepare(dict(params)), tuple(marker_strokes(phantom_inputs(dict(params)).phantom)))


def _painted(inputs: Inputs) -> segment.Inputs:
    scan = inputs.scan
    return replace(scan, markers=load_markers((), inputs.strokes, scan.table, scan.filtered.geometry, Path()))


def heartcase(inputs: Inputs) -> Segmentation:
    return segment.heartcase(_painted(inputs))


def simpleitk(inputs: Inputs) -> Segmentation:
    return segment.simpleitk(_painted(inputs))


METHODS = {"heartcase": heartcase, "simpleitk": simpleitk}


def errors(inputs: Inputs, output: Segmentation) -> dict[str, float]:
    """Dice against the truth, and the voxels that differ from a flood by SimpleITK of the same markers."""
    peer = segment.simpleitk(_painted(inputs))
    return {
        "blood pool Dice [1]": dice(output.labels, inputs.scan.true_labels, output.table.blood_values),
        "left myocardium Dice [1]": dice(
            output.labels, inputs.scan.true_labels, output.table["left ventricular myocardium"].value
        ),
        "voxels unlike simpleitk's [%]": 100.0 * float((output.labels != peer.labels).mean()),
    }
