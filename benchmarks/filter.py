"""Edge-preserving smoothing: ours beside SimpleITK's filter of the same scheme."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import SimpleITK as sitk

from benchmarks.phantom_inputs import PhantomInputs, phantom_inputs
from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.filter_scan import filter_scan, resolve_filter
from heartcase.schemas.recipe.settings import FilterSettings

sitk.ProcessObject.SetGlobalWarningDisplay(False)


@dataclass(frozen=True)
class Inputs:
    """A phantom's scan with and without noise, and settings with what the stage finds from the scan filled in."""

    source: PhantomInputs
    settings: FilterSettings
    settings_seconds: float


def prepare(params: dict[str, Any]) -> Inputs:
    chosen = FilterSettings(method=params.pop("method", None))
    source = phantom_inputs(params)
    resolve_filter(chosen, source.scan)
    start = time.perf_counter()
    settings = resolve_filter(chosen, source.scan)
    return Inputs(source, settings, time.perf_counter() - start)


def heartcase(inputs: Inputs) -> Scan:
    return filter_scan(inputs.source.scan, inputs.settings)


def simpleitk(inputs: Inputs) -> Scan:
    scan, settings = inputs.source.scan, inputs.settings
    image = sitk.GetImageFromArray(scan.values)
    image.SetSpacing(scan.geometry.spacing_mm)
    is_curvature = settings.method == "curvature_diffusion"
    diffuse = sitk.CurvatureAnisotropicDiffusion if is_curvature else sitk.GradientAnisotropicDiffusion
    smoothed = diffuse(
        image,
        # on cubic voxels: it divides by the spacing once where the divergence in mm divides twice
        timeStep=settings.time_step / scan.geometry.spacing_mm[0],
        conductanceParameter=settings.conductance,
        conductanceScalingUpdateInterval=1,
        numberOfIterations=settings.iterations,
    )
    return Scan(sitk.GetArrayFromImage(smoothed), scan.geometry)


METHODS = {"heartcase": heartcase, "simpleitk": simpleitk}


def errors(inputs: Inputs, output: Scan) -> dict[str, float]:
    """Root mean square distance from the scan without noise, per cent of its range, and how the settings were found."""
    clean, scan = inputs.source.clean.values, inputs.source.scan
    extent = float(np.ptp(clean)) / 100.0
    heart = inputs.source.truth.labels > 0

    def rms(values: Any) -> float:
        return float(np.sqrt(np.mean(np.square(values - clean, dtype=np.float64)[heart]))) / extent

    fixed = filter_scan(scan, FilterSettings(method=inputs.settings.method, conductance=1.0)).values
    peer = simpleitk(inputs).values
    return {
        "voxels [million]": scan.values.size / 1e6,
        "noise before, in the heart [% of range]": rms(scan.values),
        "error after, in the heart [% of range]": rms(output.values),
        "error after, conductance 1 [% of range]": rms(fixed),
        "largest difference to simpleitk [% of range]": float(np.abs(output.values - peer).max()) / extent,
        "conductance from the noise [1]": float(inputs.settings.conductance or 0.0),
        "finding the conductance [s]": inputs.settings_seconds,
    }
