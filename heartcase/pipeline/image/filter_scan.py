"""Edge-preserving smoothing of a scan (thesis 11.1.2), with the settings that suit its noise.

Two schemes, in mm, with c = exp(-|grad u|^2 / (2 K^2)):

- by curvature, du/dt = |grad u| div(c grad u / |grad u|): Whitaker and Xue, "Variable-conductance, level-set curvature
  for image denoising", Proc. ICIP (2001). Surfaces of equal intensity move by their curvature, so a border is smoothed
  along itself and hardly across. This is the default for CT. In a wall of one voxel their scheme lets the noise of the
  wall itself lift it: of the two slopes across, only those towards the side that a voxel moves to count. So here each
  slope that carries a surface counts with its own c: what is steeper than K stays.
- by gradient, du/dt = div(c grad u): Perona and Malik, with the full gradient at each voxel face as in Gerig, Kuebler,
  Kikinis and Jolesz, "Nonlinear anisotropic filtering of MRI data", IEEE Trans. Medical Imaging 11 (1992). This is the
  default for MRI, where the labels after it are the better ones (``heartcase bench accuracy-default``).

K is ``conductance`` times the root mean square gradient of the scan, taken anew before each step, so a setting serves
every scanner's intensities. Where the recipe leaves it out it follows from the scan's own noise: see
:meth:`FilterRules.conductance`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from decimal import ROUND_DOWN, Context
from functools import cached_property

import numpy as np

from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.diffusion import diffuse, mean_square_gradient
from heartcase.pipeline.image.noise import estimate_noise
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.resolved import DiffusionFilter, DiffusionMethod, NoFilter, ResolvedFilter
from heartcase.schemas.recipe.settings import FilterSettings

__all__ = ["FilterRules", "default_conductance", "filter_scan", "resolve_filter", "time_step_limit"]

NOISE_GRADIENTS = {"gradient_diffusion": 2.0, "curvature_diffusion": 3.0}
"""K of the default conductance, by method, in units of the root mean square gradient that the scan's noise makes.

``heartcase bench filter`` prints the error that it leaves beside that of a conductance of 1, ``heartcase bench
accuracy-default`` what becomes of the labels.
"""
CONDUCTANCE_RANGE = (0.001, 100.0)
"""Least and largest default conductance."""
TIME_STEP_TOLERANCE = 1e-6
"""Relative excess over the limit that a time step typed with rounded digits may have."""


def filter_scan(scan: Scan, settings: FilterSettings) -> Scan:
    """Smooth a scan and keep its edges.

    Parameters
    ----------
    scan
        The scan.
    settings
        Method, number of steps, conductance, time step.

    Returns
    -------
    Scan
        The same scan with smoothed values; the very same object for ``method="none"``.

    Raises
    ------
    StageError
        The scan holds values that are not finite, or the time step is beyond the stability limit.
    """
    chosen = resolve_filter(settings, scan)
    if isinstance(chosen, NoFilter):
        return scan
    _check_values(scan)
    limit = time_step_limit(scan.geometry, chosen.method)
    if chosen.time_step > limit * (1.0 + TIME_STEP_TOLERANCE):
        shown = Context(prec=4, rounding=ROUND_DOWN).create_decimal_from_float(limit)
        raise StageError(
            f"{chosen.time_step:g} is beyond the stability limit of this scan's spacing, {shown:f} mm2; "
            "give at most that, or leave it out",
            place="filter.time_step",
        )
    values = diffuse(
        scan.values,
        scan.geometry.spacing_mm,
        iterations=chosen.iterations,
        conductance=chosen.conductance,
        time_step=chosen.time_step,
        by_curvature=chosen.method == "curvature_diffusion",
    )
    return dataclasses.replace(scan, values=values)


@dataclass(frozen=True)
class FilterRules:
    """What the filter takes for a scan where the settings leave it open; what it needs of the scan is found once."""

    scan: Scan
    """The scan that is filtered."""

    def resolve(self, settings: FilterSettings) -> ResolvedFilter:
        """Settings with what they leave to the scan filled in: method, time step and conductance.

        Raises
        ------
        StageError
            The conductance is left out, and the scan holds values that are not finite.
        """
        if isinstance(settings, NoFilter | DiffusionFilter):
            return settings
        if settings.method == "none":
            return NoFilter.of(settings)
        method = settings.method or self.method
        return DiffusionFilter.of(
            settings,
            method=method,
            time_step=self.time_step(method) if settings.time_step is None else settings.time_step,
            conductance=self.conductance(method) if settings.conductance is None else settings.conductance,
        )

    @property
    def method(self) -> DiffusionMethod:
        """By curvature for a CT, by gradient for others."""
        return "curvature_diffusion" if self.scan.modality == "CT" else "gradient_diffusion"

    def time_step(self, method: DiffusionMethod) -> float:
        """The stability limit, mm2; for a single voxel, which nothing flows into, any number does."""
        limit = time_step_limit(self.scan.geometry, method)
        return limit if math.isfinite(limit) else 1.0

    def conductance(self, method: DiffusionMethod) -> float:
        """Conductance at which noise is smoothed and edges stay: K is NOISE_GRADIENTS times the gradient of the noise.

        Between 0.001, where there is no noise and nothing changes, and 100; to four digits, so that another processor's
        rounding does not show in a locked recipe.

        Raises
        ------
        StageError
            The scan holds values that are not finite.
        """
        of_noise, of_scan = self._gradients
        if not of_scan > 0.0:
            return 1.0
        lower, upper = CONDUCTANCE_RANGE
        return float(f"{min(max(NOISE_GRADIENTS[method] * of_noise / of_scan, lower), upper):.4g}")

    @cached_property
    def _gradients(self) -> tuple[float, float]:
        """Root mean square gradients per mm: that which the noise makes, and the scan's."""
        scan = self.scan
        _check_values(scan)
        geometry = scan.geometry
        extent = float(scan.values.max()) - float(scan.values.min())
        total = mean_square_gradient(scan.values, geometry.spacing_mm, extent) if extent > 0.0 else 0.0
        if not total > 0.0:
            return 0.0, 0.0
        squares = (0.5 / h**2 for h, n in zip(geometry.spacing_mm, geometry.size, strict=True) if n > 1)
        return estimate_noise(scan.values).difference_sigma * math.sqrt(sum(squares)), math.sqrt(total)


def resolve_filter(settings: FilterSettings, scan: Scan) -> ResolvedFilter:
    """Settings with what they leave to the scan filled in; resolved ones come back as they are.

    Parameters
    ----------
    settings
        Any.
    scan
        The scan that is filtered.

    Raises
    ------
    StageError
        The conductance is left out, and the scan holds values that are not finite.
    """
    return FilterRules(scan).resolve(settings)


def default_conductance(scan: Scan, method: DiffusionMethod = "gradient_diffusion") -> float:
    """Conductance for a scan where none is stated: :meth:`FilterRules.conductance`."""
    return FilterRules(scan).conductance(method)


def _check_values(scan: Scan) -> None:
    if np.isfinite(scan.values.min()) and np.isfinite(scan.values.max()):
        return
    bad = int(np.size(scan.values) - np.count_nonzero(np.isfinite(scan.values)))
    raise StageError(
        f"{bad} voxels of the scan are NaN or infinite; give them the intensity of air or crop them away",
        place="filter",
    )


def time_step_limit(geometry: Geometry, method: DiffusionMethod = "gradient_diffusion") -> float:
    """Longest stable diffusion step, mm2, over the axes that have more than one voxel.

    By gradient it is 1 / (4 sum 1/h^2). Up to there every spatial frequency is damped by a factor between 0 and 1 (the
    largest eigenvalue of the discrete Laplacian is 4 sum 1/h^2 and no conductance exceeds one), and each new value is
    an average of old ones with weights that are not negative. Twice as long a step still obeys the maximum principle,
    but turns the sign of the finest frequency, which is mostly noise, instead of removing it.

    By curvature it is 1 / (2 sum 1/h sqrt(2 sum 1/h^2)). No part of a normal exceeds one, so a voxel moves by at most
    2 sum 1/h times its upwind slope, and that slope is at most sqrt(2 sum 1/h^2) times the largest difference to a
    neighbour on the side that it moves to: so no voxel passes its neighbours, and one that stands out alone comes down
    to them at once.
    """
    spacing = [h for h, n in zip(geometry.spacing_mm, geometry.size, strict=True) if n > 1]
    if not spacing:
        return math.inf
    squares = sum(h**-2 for h in spacing)
    if method == "curvature_diffusion":
        return 0.5 / (sum(1.0 / h for h in spacing) * math.sqrt(2.0 * squares))
    return 0.25 / squares
