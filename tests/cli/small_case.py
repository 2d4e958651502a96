"""A small scan and a small case on disk for the tests of the command line."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK
from scipy.spatial.transform import Rotation

from heartcase.pipeline.bundle.write_bundle import (
    BundleParts,
    BundleRecord,
    BundleSource,
    assemble_bundle,
    write_bundle,
)
from heartcase.pipeline.warnings import CaseWarning, worst_first
from heartcase.schemas.bundle.format import Material
from tests.pipeline.report.analytic_heart import AnalyticHeart, make_heart

SCAN_DIRECTION = Rotation.from_euler("x", 10.0, degrees=True).as_matrix() @ np.array(
    [[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
)
"""Axes to the right, to the head and to the back, tilted by ten degrees about the patient's left-right axis."""


def write_scan(path: Path) -> Path:
    """An oblique, anisotropic scan of 12 x 10 x 8 voxels with a bright block."""
    values = np.random.default_rng(1).normal(50.0, 5.0, (8, 10, 12)).astype(np.float32)
    values[2:6, 3:7, 4:8] += 100.0
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((1.0, 1.5, 2.5))
    image.SetOrigin((5.0, -7.0, 11.0))
    image.SetDirection(SCAN_DIRECTION.ravel().tolist())
    SimpleITK.WriteImage(image, str(path))
    return path


def write_case(
    directory: Path,
    *,
    with_level: bool = False,
    warnings: Sequence[CaseWarning] = (CaseWarning("a warning for the reader"),),
) -> tuple[Path, AnalyticHeart]:
    """A case with a grid and a surface, and where asked for a coarser level of it."""
    heart = make_heart(spacing_mm=(3.0, 3.0, 3.0))
    coarse = (make_heart(spacing_mm=(5.0, 5.0, 5.0)).surface,) if with_level else ()
    content = assemble_bundle(
        BundleParts(grid=heart.grid, surface=replace(heart.surface, levels=coarse)),
        [Material(label=v, youngs_modulus_kpa=30, density_kg_m3=1060) for v in heart.table.tissue_values],
        BundleSource(geometry=heart.scan.geometry, sha256="0" * 64, modality="CT"),
        BundleRecord(
            name="Toy",
            quality={"volumes_ml": {"morphologically left ventricle": 33.0}},
            warnings=worst_first(warnings),
        ),
    )
    path = directory / "Toy.case"
    write_bundle(path, content)
    return path, heart
