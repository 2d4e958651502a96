"""Edge-preserving smoothing: ours beside SimpleITK's filter of the same scheme."""

from __future__ import annotations

from typing import Any

import numpy as np
import SimpleITK as sitk
from phantom_inputs import PhantomInputs, phantom_inputs

from heartcase.pipeline.data import Scan
from heartcase.pipeline.filter import filter_scan, time_step_limit
from heartcase.schemas.settings import FilterSettings

SETTINGS = FilterSettings()
sitk.ProcessObject.SetGlobalWarningDisplay(False)


def prepare(params: dict[str, Any]) -> PhantomInputs:
    return phantom_inputs(params)


def heartcase(inputs: PhantomInputs) -> Scan:
    return filter_scan(inputs.scan, SETTINGS)


def simpleitk(inputs: PhantomInputs) -> Scan:
    image = sitk.GetImageFromArray(inputs.scan.values)
    image.SetSpacing(inputs.scan.geometry.spacing_mm)
    smoothed = sitk.GradientAnisotropicDiffusion(
        image,
        timeStep=time_step_limit(inputs.scan.geometry),
        conductanceParameter=SETTINGS.conductance,
        conductanceScalingUpdateInterval=1,
        numberOfIterations=SETTINGS.iterations,
    )
    return Scan(sitk.GetArrayFromImage(smoothed), inputs.scan.geometry)


METHODS = {"heartcase": heartcase, "simpleitk": simpleitk}


def errors(inputs: PhantomInputs, output: Scan) -> dict[str, float]:
    """Root mean square distance from the scan without noise, before and after, per cent of its range."""
    extent = float(np.ptp(inputs.clean.values)) / 100.0

    def rms(values: Any) -> float:
        return float(np.sqrt(np.mean(np.square(values - inputs.clean.values, dtype=np.float64)))) / extent

    peer = simpleitk(inputs).values
    return {
        "noise before [% of range]": rms(inputs.scan.values),
        "error after [% of range]": rms(output.values),
        "largest difference to simpleitk [% of range]": float(np.abs(output.values - peer).max()) / extent,
    }
