"""Loading a case: only the parts that a scene needs are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from heartcase.schemas.arrays import Float32, Int16, UInt8
from heartcase.schemas.bundle.format import CaseManifest, FileRole, ScanValues
from heartcase.schemas.bundle.lattice import FULL_MOMENTS
from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
from heartcase.schemas.errors import BundleError, SimulationError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.model import LatticeModel, make_model
from heartcase.simulator.surface.deform import (
    Curvature,
    PickingModel,
    SurfaceModel,
    check_curvature,
    make_picking,
    make_surface,
)
from heartcase.simulator.surface.tissue_inside import tissue_inside

__all__ = ["Case", "Need", "ScanVolume", "load_case"]

Need = Literal["grid", "surface", "tangents", "colours", "picking", "tissue", "scan", "structures", "cell_labels"]
"""Parts of a scene: the lattice (always), the visible surface, its tangents for normal mapping, the colour of its
triangles, the one-to-one surface, where in its cells the tissue lies that blades cut, the scan for slices, the
structure of each triangle, to show and hide, the label of each cell, to show it cut open."""


@dataclass(frozen=True)
class ScanVolume:
    """The filtered scan, as it is stored: 16 bits a voxel, mapped into memory."""

    stored: Int16
    """Whole numbers, [z, y, x], shape ``geometry.shape``; read-only."""
    geometry: Geometry
    """Where the voxel centres lie."""
    values: ScanValues
    """What a stored number stands for."""

    def slice_at(self, index: int) -> Float32:
        """Intensities of one plane of voxels along k (Hounsfield units for CT), float32, shape (size j, size i)."""
        plane: Float32 = self.stored[index] * np.float32(self.values.slope)
        plane += np.float32(self.values.intercept)
        return plane


@dataclass(frozen=True)
class Case:
    """A case, ready to be simulated."""

    manifest: CaseManifest
    """What the case says of itself."""
    model: LatticeModel
    """The lattice."""
    surface: SurfaceModel | None = None
    """The visible surface, where it was asked for."""
    triangle_colours: UInt8 | None = None
    """Red, green, blue of each triangle, shape (triangle_count, 3), where they were asked for."""
    picking: PickingModel | None = None
    """The one-to-one surface, where it was asked for."""
    tissue: TissueSamples | None = None
    """Where in its cells the tissue lies, by the finest surface, where it was asked for: for blades."""
    scan: ScanVolume | None = None
    """The scan, where it was asked for."""
    triangle_structures: UInt8 | None = None
    """Label whose colour each triangle has, shape (triangle_count,), where they were asked for."""
    cell_labels: UInt8 | None = None
    """Tissue label that fills most of each cell, shape (cell_count,), where they were asked for."""


def load_case(
    path: Path | str,
    *,
    needs: Sequence[Need] = ("grid", "surface"),
    curvature: Curvature = "flagged",
    level: int = 0,
) -> Case:
    """Load a case bundle.

    Parameters
    ----------
    path
        The bundle's directory, ``NAME.case``.
    needs
        What the scene needs; nothing else is read.
    curvature
        Where the surface follows the interpolated basis: per-vertex flag, everywhere, nowhere.
    level
        Level of detail of the surface: 0 is the finest; other levels are not read.

    Raises
    ------
    UsageError
        The needs are a text instead of a list of them, a need or the curvature is unknown, or the case does not have
        the level.
    BundleError
        The bundle is broken, or was made without a part that is needed.
    """
    if isinstance(needs, str):
        # A text is a sequence too: of its letters.
        raise UsageError(f"needs is a list of what the scene needs: write needs=[{needs!r}]")
    unknown = sorted(set(needs) - set(get_args(Need)))
    if unknown:
        raise UsageError(f"a scene cannot need {', '.join(unknown)}; it can need {', '.join(get_args(Need))}")
    check_curvature(curvature, "curvature", UsageError)
    bundle = open_bundle(path)
    wants_surface = bool({"surface", "tangents", "colours", "structures"} & set(needs))
    if wants_surface:
        bundle.surface_role(level)
    model = _model(bundle)
    surface = _surface(bundle, model, curvature, level, tangents="tangents" in needs) if wants_surface else None
    tissue = None
    if "tissue" in needs:
        finest = surface if level == 0 else None
        tissue = tissue_inside(model, finest or _surface(bundle, model, "none", 0, tangents=False))
    return Case(
        manifest=bundle.manifest,
        model=model,
        surface=surface,
        tissue=tissue,
        triangle_colours=_triangle_colours(bundle, level) if "colours" in needs else None,
        picking=make_picking(model, **bundle.arrays(FileRole.PICKING, ("nodes", "triangles")))
        if "picking" in needs
        else None,
        scan=_scan(bundle) if "scan" in needs else None,
        triangle_structures=_triangle_structures(bundle, level) if "structures" in needs else None,
        cell_labels=bundle.arrays(FileRole.GRID, ("cell_label",))["cell_label"] if "cell_labels" in needs else None,
    )


def _scan(bundle: OpenBundle) -> ScanVolume:
    stored = bundle.arrays(FileRole.SCAN)["intensity"]
    values = cast("ScanValues", bundle.manifest.scan_values)  # opening refuses a scan part without them
    return ScanVolume(stored, bundle.manifest.scan_geometry, values)


def _model(bundle: OpenBundle) -> LatticeModel:
    names = ["cells", "cell_coverage", "cell_stiffness", "cell_density", "fixed"]
    # A case of an older version does not know where in its cells the tissue lies: they count as full.
    has_moments = "cell_moments" in bundle.headers[FileRole.GRID].arrays
    grid = bundle.arrays(FileRole.GRID, [*names, "cell_moments"] if has_moments else names)
    try:
        return make_model(
            grid["cells"],
            coverage=grid["cell_coverage"],
            stiffness_kpa=grid["cell_stiffness"],
            density_kg_m3=grid["cell_density"],
            fixed=grid["fixed"],
            geometry=bundle.manifest.grid_geometry,
            moments=grid.get("cell_moments", FULL_MOMENTS),
        )
    except SimulationError as error:
        raise BundleError(error.problems) from None


def _surface(
    bundle: OpenBundle, model: LatticeModel, curvature: Curvature, level: int, *, tangents: bool
) -> SurfaceModel:
    names = ["triangle_nodes", "weights", "offset", "normal", "curvature"]
    mapping = bundle.arrays(FileRole.MAPPING.at(level), [*names, "tangent"] if tangents else names)
    mesh = bundle.arrays(FileRole.SURFACE.at(level), ["triangles", "render_to_welded"] if tangents else ["triangles"])
    return make_surface(
        model,
        triangle_nodes=mapping["triangle_nodes"],
        weights=mapping["weights"],
        offset_mm=mapping["offset"],
        normal=mapping["normal"],
        curvature=mapping["curvature"],
        mode=curvature,
        triangles=mesh["triangles"],
        render_to_welded=mesh.get("render_to_welded"),
        tangent=mapping.get("tangent"),
    )


def _triangle_structures(bundle: OpenBundle, level: int) -> UInt8:
    """Label of the cavity that a triangle faces; outside, of the tissue behind it."""
    mesh = bundle.arrays(FileRole.SURFACE.at(level), ("triangle_label", "triangle_tissue"))
    found: UInt8 = np.where(mesh["triangle_label"] == 0, mesh["triangle_tissue"], mesh["triangle_label"])
    return found


def _triangle_colours(bundle: OpenBundle, level: int) -> UInt8:
    """Colour of each triangle's structure."""
    palette = np.zeros((256, 3), np.uint8)
    for label in bundle.manifest.labels:
        palette[label.value] = [int(label.colour[at : at + 2], 16) for at in (1, 3, 5)]
    return palette[_triangle_structures(bundle, level)]
