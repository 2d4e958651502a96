"""A finished segmentation and a scan that goes with it, on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import SimpleITK

from heartcase.pipeline.data import Segmentation

__all__ = ["write_labels"]


def write_labels(directory: Path, segmentation: Segmentation) -> None:
    """Write ``labels.nii.gz`` and ``scan.nii.gz``, blood bright."""
    values = np.where(segmentation.labels > 0, 200.0, 40.0).astype(np.float32)
    for name, array in (("labels", segmentation.labels), ("scan", values)):
        image = SimpleITK.GetImageFromArray(array)
        image.SetSpacing(segmentation.geometry.spacing_mm)
        image.SetOrigin(segmentation.geometry.origin_mm)
        image.SetDirection(segmentation.geometry.direction_matrix.ravel().tolist())
        SimpleITK.WriteImage(image, str(directory / f"{name}.nii.gz"))
