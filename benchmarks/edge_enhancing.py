"""Would edge-enhancing diffusion leave less error than the filter that heartcase has? Both, and the labels after them.

Smoothing is full along an edge; across it the diffusivity is 1 - exp(-3.31488 / (s / contrast)^8) of the blurred
gradient s (Weickert, "Anisotropic Diffusion in Image Processing", 1998, sections 1.3.3 and 2.2). In plain NumPy, so
its time says nothing.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from benchmarks.phantom_inputs import PhantomInputs, bare_truth, phantom_inputs
from heartcase.phantom.drawing.strokes import marker_strokes
from heartcase.phantom.metrics import dice
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.filter_scan import filter_scan, time_step_limit
from heartcase.pipeline.image.noise import estimate_noise
from heartcase.pipeline.markers.load_markers import load_markers
from heartcase.pipeline.watershed.segment_scan import segment_scan
from heartcase.schemas.arrays import Float32
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings

FLUX_PEAK = 3.31488
"""Makes the flux across an edge largest where the gradient equals the contrast, for the power of eight."""


@dataclass(frozen=True)
class Inputs:
    """A phantom's scan with what is true of it, and the settings of the edge-enhancing diffusion."""

    source: PhantomInputs
    contrast: float
    steps: int
    sigma_mm: float


def prepare(params: dict[str, Any]) -> Inputs:
    contrast, steps, sigma_mm = params.pop("contrast"), params.pop("steps"), params.pop("sigma_mm")
    return Inputs(phantom_inputs(params), contrast, steps, sigma_mm)


def heartcase(inputs: Inputs) -> Scan:
    return filter_scan(inputs.source.scan, FilterSettings(method="gradient_diffusion"))


def edge_enhancing(inputs: Inputs) -> Scan:
    scan = inputs.source.scan
    values = scan.values
    for _ in range(inputs.steps):
        values = edge_enhancing_step(
            values,
            scan.geometry.spacing_mm,
            contrast=inputs.contrast * estimate_noise(scan.values).difference_sigma,
            sigma_mm=inputs.sigma_mm,
            time_step=time_step_limit(scan.geometry, "gradient_diffusion"),
        )
    return dataclasses.replace(scan, values=values)


METHODS = {"heartcase": heartcase, "edge_enhancing": edge_enhancing}


def edge_enhancing_step(
    values: Float32, spacing_mm: tuple[float, float, float], *, contrast: float, sigma_mm: float, time_step: float
) -> Float32:
    """One explicit step; no flux through the outer faces.

    The tensor I - less n n^T with the edge's normal n is split: the identity acts through the voxels' faces, the rest
    at their corners, through the mean gradient of the eight voxels there and the adjoint of that. So the step is
    symmetric, damps every pattern, and is stable up to the time step of the Laplacian.

    Parameters
    ----------
    values
        Shape [z, y, x].
    spacing_mm
        Along x, y, z.
    contrast
        Gradient from which on an edge is kept, per mm.
    sigma_mm
        Blur of the volume whose gradient tells where edges are and how they lie.
    time_step
        mm2.
    """
    steps = spacing_mm[::-1]
    change = np.zeros_like(values)
    for axis, step in enumerate(steps):
        flux = np.diff(values, axis=axis) / step**2
        change[_low(axis)] += flux
        change[_high(axis)] -= flux
    normal = _corner_gradient(
        ndimage.gaussian_filter(values, [sigma_mm / step for step in steps], mode="nearest"), steps
    )
    square = sum(component**2 for component in normal)
    less = np.exp(-FLUX_PEAK / np.clip((square / contrast**2) ** 4, 1e-3, 1e8)) / np.maximum(square, 1e-20)
    along = less * sum(a * b for a, b in zip(normal, _corner_gradient(values, steps), strict=True))
    for axis, step in enumerate(steps):
        flux = along * normal[axis]
        for other in {0, 1, 2} - {axis}:
            padded = np.pad(flux, [(1, 1) if n == other else (0, 0) for n in range(3)])
            flux = 0.5 * (padded[_low(other)] + padded[_high(other)])
        change[_low(axis)] -= flux / step
        change[_high(axis)] += flux / step
    found: Float32 = (values + time_step * change).astype(np.float32)
    return found


def _low(axis: int) -> tuple[slice, ...]:
    return (slice(None),) * axis + (slice(None, -1),)


def _high(axis: int) -> tuple[slice, ...]:
    return (slice(None),) * axis + (slice(1, None),)


def _corner_gradient(values: Float32, steps: tuple[float, ...]) -> list[Float32]:
    """Mean gradient between neighbours of each 2 x 2 x 2 voxels, per mm, along z, y and x."""
    found = []
    for axis, step in enumerate(steps):
        component = np.diff(values, axis=axis) / np.float32(step)
        for other in {0, 1, 2} - {axis}:
            component = np.float32(0.5) * (component[_low(other)] + component[_high(other)])
        found.append(component)
    return found


def errors(inputs: Inputs, output: Scan) -> dict[str, float]:
    """In the heart: distance of the intensities from those without noise, and how wrong the watershed's labels are."""
    source = inputs.source
    clean = source.clean.values
    heart = source.truth.labels > 0
    truth, table = bare_truth(source), source.phantom.table
    markers = load_markers((), marker_strokes(source.phantom), table, output.geometry, Path())
    labels = segment_scan(output, markers, SegmentSettings(), table).labels
    rms = np.sqrt(np.mean(np.square(output.values - clean, dtype=np.float64)[heart]))
    return {
        "error, in the heart [% of range]": 100.0 * float(rms) / float(np.ptp(clean)),
        "wrong labels after it, in the heart [%]": 100.0 * float(np.mean(labels[heart] != truth[heart])),
        "mean Dice after it [1]": float(
            np.mean([dice(labels, truth, [v]) for v in np.unique(truth[truth > 0]).tolist()])
        ),
    }
