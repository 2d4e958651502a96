"""Small recipes that go the ways which the one of ``stage_outputs.py`` does not: as a recipe states them, from files.

Each is a heart of its own that is the same seen from no two sides, so that a mirrored or shifted array shows.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import SimpleITK

from heartcase.pipeline.data import Scan
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.geometry import Geometry

__all__ = ["SMALL_RECIPES"]


TILT = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
SPACING_MM, SHAPE = (2.2, 2.0, 2.4), (18, 20, 17)
LEFT_MM, RIGHT_MM = np.array([-6.0, 0.0, 0.0]), np.array([11.0, 2.0, 2.0])

LABELS = """
heartcase_recipe = 1
name = "labels"
case_id = "STAGES-2"
parts = ["labels", "scan"]
scan = { path = "scan.nii", modality = "MR" }
labels = [
  { value = 1, name = "morphologically left ventricle", role = "blood", colour = "#ff0000" },
  { value = 2, name = "morphologically right ventricle", role = "blood", colour = "#0000ff", wall_thickness_mm = 2.0 },
  { value = 3, name = "myocardium", role = "myocardium", colour = "#ffff00" },
]
segment = { method = "labels", file = "finished.nrrd", names = { "tumour" = "myocardium" }, others = "ignore" }
edits = [
  { kind = "septal_defect", position_mm = [3, 1, 1], diameter_mm = 4.0, axis = [1, 0.1, 0.1], length_mm = 13.0 },
  { kind = "close_defect", position_mm = [-6, 0, 0], diameter_mm = 5.0, axis = [0, 1, 1] },
  { kind = "add", label = "myocardium", radius_mm = 2.0, points_mm = [[0, 12, 4], [4, 13, 4]] },
  { kind = "remove", label = "myocardium", radius_mm = 2.5, points_mm = [[-9, -6, 0]], into = "background" },
]
pins = [{ position_mm = [0, -10, 0], radius_mm = 5.0 }]
filter = { iterations = 1 }
grid = { node_count = 900 }
"""

THRESHOLD = """
heartcase_recipe = 1
name = "threshold"
case_id = "STAGES-3"
parts = ["scan"]
scan = { path = "scan.nii", modality = "CT" }
labels = [
  { value = 1, name = "one", role = "blood", colour = "#ff0000" },
  { value = 4, name = "four", role = "myocardium", colour = "#ffff00" },
]
pins = [{ position_mm = [0, -10, 0], radius_mm = 5.0 }]
filter = { iterations = 1 }
grid = { cell_mm = 4.0 }
[segment]
method = "threshold"
smallest_piece_ml = 0.2
ranges = [{ label = "one", lower = 145.0 }, { label = "four", lower = 70.0, upper = 190.0 }]
"""

POINTS = """
heartcase_recipe = 1
name = "points"
case_id = "STAGES-4"
parts = ["scan"]
scan = { path = "scan.nii", modality = "CT" }
markers = [
  { path = "cavities.mha", convention = "hvsmr-2.0" },
  { path = "background.mrk.json", names = { "muscle" = "morphologically left ventricular myocardium" } },
]
pins = [{ position_mm = [0, -10, 0], radius_mm = 5.0 }]
grid = { node_count = 700 }
"""


def _lattice(shape: tuple[int, int, int], spacing_mm: tuple[float, float, float]) -> Geometry:
    """A tilted lattice around the world's origin."""
    first = -0.5 * np.array(spacing_mm) * (np.array(shape[::-1]) - 1)
    return Geometry.of(shape=shape, spacing_mm=spacing_mm, origin_mm=TILT @ first, direction=TILT)


def _world(geometry: Geometry) -> Float64:
    k, j, i = np.indices(geometry.shape)
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


def _structures(points_mm: Float64) -> UInt8:
    """A ball of muscle (3) with a cavity in it (1), and a smaller one that looks out of it, higher and behind (2)."""
    labels = np.where(np.linalg.norm(points_mm, axis=-1) < 14.0, 3, 0).astype(np.uint8)
    labels[np.linalg.norm(points_mm - LEFT_MM, axis=-1) < 5.5] = 1
    labels[np.linalg.norm(points_mm - RIGHT_MM, axis=-1) < 4.5] = 2
    return labels


def _write_scan(directory: Path, intensities: tuple[float, ...], noise: float, *, speck: float | None = None) -> None:
    """Background, the two cavities, and muscle at these intensities, with noise of a fixed seed and no whole number."""
    geometry = _lattice(SHAPE, SPACING_MM)
    values = np.array(intensities)[_structures(_world(geometry))]
    if speck is not None:
        values[1:3, 1:3, 1:3] = speck
    values += np.random.Generator(np.random.PCG64(5)).uniform(-noise, noise, values.shape)
    write_scan(Scan(values.astype(np.float32), geometry, "MR"), directory / "scan.nii")


def _write_labels(path: Path, labels: UInt8, geometry: Geometry, names: dict[int, str] | None = None) -> None:
    image = SimpleITK.GetImageFromArray(labels)
    image.SetSpacing(geometry.spacing_mm)
    image.SetOrigin(geometry.origin_mm)
    image.SetDirection(TILT.ravel().tolist())
    for n, (value, name) in enumerate((names or {}).items()):
        for key, text in (("ID", f"S{n}"), ("Name", name), ("LabelValue", str(value)), ("Layer", "0")):
            image.SetMetaData(f"Segment{n}_{key}", text)
    SimpleITK.WriteImage(image, str(path), True)


def _labels(directory: Path) -> None:
    """A finished segmentation on a finer, smaller lattice, its segments called by synonyms and by the recipe."""
    _write_scan(directory, (100.0, 900.0, 1000.0, 400.0), 15.0)
    geometry = _lattice((24, 23, 25), (1.5, 1.6, 1.3))
    in_file = np.array([0, 7, 2, 5], np.uint8)[_structures(_world(geometry))]
    in_file[:2, :2, :2] = 9
    _write_labels(
        directory / "finished.nrrd", in_file, geometry, {5: "tumour", 7: "LV", 2: "heart_ventricle_right", 9: "spleen"}
    )
    (directory / "recipe.toml").write_text(LABELS)


def _threshold(directory: Path) -> None:
    """Intensities that span a little more than 256 HU, some of them in two ranges; a speck that is too small."""
    _write_scan(directory, (-40.0, 170.0, 220.0, 100.0), 8.0, speck=130.0)
    (directory / "recipe.toml").write_text(THRESHOLD)


def _points(directory: Path) -> None:
    """Markers from a volume of numbers and from points and lines; CT that spans a little less than 256 HU."""
    _write_scan(directory, (30.0, 250.0, 240.0, 110.0), 8.0)
    geometry = _lattice(SHAPE, SPACING_MM)
    inner = _structures(1.6 * (_world(geometry) - LEFT_MM) + LEFT_MM) == 1
    other = _structures(1.6 * (_world(geometry) - RIGHT_MM) + RIGHT_MM) == 2
    _write_labels(directory / "cavities.mha", (inner + 2 * other).astype(np.uint8), geometry)

    def markup(kind: str, name: str, points_mm: list[list[float]], system: str) -> dict[str, object]:
        return {
            "type": kind,
            "name": name,
            "coordinateSystem": system,
            "controlPoints": [{"label": f"{name}-{n}", "position": point} for n, point in enumerate(points_mm)],
        }

    around = [[-17.0, -16.0, 0.0], [17.0, -16.0, 0.0], [17.0, 16.0, 0.0], [-17.0, 16.0, 0.0]]
    # RAS: x and y have the other sign
    inside = [[-2.0, -10.0, 0.0], [0.0, 10.0, 3.0], [0.0, 0.0, -10.0]]
    lists = [markup("ClosedCurve", "", around, "LPS"), markup("Fiducial", "muscle", inside, "RAS")]
    (directory / "background.mrk.json").write_text(json.dumps({"markups": lists}))
    (directory / "recipe.toml").write_text(POINTS)


SMALL_RECIPES: dict[str, Callable[[Path], None]] = {"labels": _labels, "threshold": _threshold, "points": _points}
"""Name -> what writes ``recipe.toml`` and its files into a folder."""
