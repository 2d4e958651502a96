"""From the settings of a synthetic scan to the scan."""

from __future__ import annotations

from typing import Any

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.scan.acquisition import (
    SPECIMEN_UNITS,
    UNDILUTED_HU,
    CtArtefacts,
    MriArtefacts,
    SyntheticScan,
    acquire_ct,
    acquire_mri,
)
from heartcase.schemas.recipe.phantom_scan import PhantomScan

__all__ = ["made_scan"]

_SPECIMEN_CONTRAST = 40.0
"""Air is darker than tissue by 1,100 HU: 40 is the noise of an ordinary scan, 27 HU."""


def made_scan(settings: PhantomScan) -> SyntheticScan:
    """The scan that settings describe; some seconds to a minute.

    Raises
    ------
    UsageError
        The heart has no place for a defect.
    """
    phantom = HeartPhantom.of_form(settings.heart)
    geometry = phantom.scan_geometry(settings.spacing_mm, margin_mm=settings.margin_mm, oblique=settings.is_oblique)
    options: dict[str, Any] = {"seed": settings.seed}
    if settings.contrast_to_noise is not None:
        options["contrast_to_noise"] = settings.contrast_to_noise
    if settings.modality == "MR":
        artefacts = MriArtefacts(motion_mm=settings.motion_mm, ghost=settings.ghost)
        return acquire_mri(phantom, geometry, bias=settings.bias, artefacts=artefacts, **options)
    options["slice_thickness_mm"] = settings.slice_thickness_mm
    if settings.is_specimen:
        options = {"contrast_to_noise": _SPECIMEN_CONTRAST, "units": SPECIMEN_UNITS, "in_air": True} | options
    caval_hu = UNDILUTED_HU if settings.streak_hu > 0.0 and not settings.is_specimen else None
    disturbed = CtArtefacts(texture=settings.has_noise_texture, streak=settings.streak_hu, caval_hu=caval_hu)
    return acquire_ct(phantom, geometry, artefacts=disturbed, **options)
