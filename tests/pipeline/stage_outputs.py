"""Small cases through every stage, and a fingerprint of each stage's output."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pygltflib
import SimpleITK
from PIL import Image
from safetensors.numpy import load_file

from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.building.runner import Runner, SilentListener, run_stages
from heartcase.pipeline.data import Scan, Structures
from heartcase.pipeline.fields.reader import ownership_on_lattice
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.pipeline.stages.resolve import resolve_recipe
from heartcase.pipeline.stages.stage import Work
from heartcase.schemas.bundle.format import ARRAYS, FileRole
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import parse_recipe
from tests.pipeline.stage_recipes import SMALL_RECIPES

Arrays = dict[str, np.ndarray]
Outputs = dict[str, dict[str, Arrays]]

INPUTS: dict[str, tuple[str, ...]] = {
    "read": (),
    "markers": ("read",),
    "filter": ("read",),
    "segment": ("filter", "markers"),
    "walls": ("segment",),
    "edit": ("walls",),
    "grid": ("edit",),
    "surface": ("edit",),
    "map": ("surface", "grid", "edit"),
    "bundle": ("filter", "grid", "surface", "map"),
}
"""What each stage takes: where an input changed, a changed output is no fault of the stage."""

INPUTS_ELSEWHERE: dict[str, dict[str, tuple[str, ...]]] = {
    "labels": {"segment": ("read",)},
    "threshold": {"segment": ("filter",)},
}
"""Where a recipe's stage takes something else: a finished segmentation is not filtered, thresholds have no markers."""

# Two chambers in a ball of muscle, a vessel that leaves the right one upward; mm from the ball's centre.
LEFT, RIGHT, CHAMBER_MM = np.array([-8.0, 0, -2]), np.array([8.0, 0, -2]), 6.5
BALL_MM, VESSEL_MM = 18.0, 4.5
CENTER = np.array([5.0, -7.0, 11.0])
TILT = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]])

RECIPE = """
heartcase_recipe = 1
name = "stages"
case_id = "STAGES-1"
parts = ["surface", "render", "picking", "labels"]
scan = {{ path = "scan.nii", modality = "MR" }}
region = {{ center_mm = {centre}, size_mm = [46, 44, 52] }}
labels = [
  {{ value = 1, name = "one", role = "blood", colour = "#ff0000" }},
  {{ value = 2, name = "two", role = "blood", colour = "#0000ff" }},
  {{ value = 3, name = "three", role = "vessel_lumen", colour = "#00ffff", wall_thickness_mm = 2.0 }},
  {{ value = 4, name = "four", role = "myocardium", colour = "#ffff00" }},
]
markers = [{{ path = "muscle.nrrd", names = {{ "7" = "four" }} }}]
strokes = [
  {{ label = "one", radius_mm = 3.0, points_mm = [{left}] }},
  {{ label = "two", radius_mm = 3.0, points_mm = [{right}] }},
  {{ label = "three", radius_mm = 1.5, points_mm = [{vessel_low}, {vessel_high}] }},
  {{ label = "background", radius_mm = 2.0, points_mm = [{a}, {b}, {c}, {d}] }},
]
ends = [{{ label = "three", position_mm = {end}, axis = [0, 0, 1], radius_mm = 9.0 }}]
edits = [
  {{ kind = "septal_defect", position_mm = {septum}, diameter_mm = 5.0, axis = {across}, length_mm = 12.0 }},
  {{ kind = "remove", label = "four", radius_mm = 3.0, points_mm = [{bottom}] }},
]
pins = [{{ position_mm = {bottom_pin}, radius_mm = 7.0 }}]
filter = {{ iterations = 3, conductance = 1.5 }}
segment = {{ gradient_sigma_mm = 0.0 }}
walls = {{ smoothing_mm = 1.5, band_mm = 8.0 }}
grid = {{ cell_mm = 3.0 }}
surface = {{ triangle_count = 2500, normal_map_size = 128 }}
map = {{ candidate_count = 24 }}
"""


def world(point: Iterable[float]) -> list[float]:
    """A place of the ball, patient LPS mm."""
    return [round(float(value), 3) for value in CENTER + TILT @ np.array(list(point), float)]


def write_inputs(directory: Path) -> None:
    """Write the scan (with noise of a fixed seed), a marker file and the recipe."""
    shape, spacing = (30, 28, 30), np.array([1.9, 2.0, 2.1])
    first = -0.5 * spacing * (np.array(shape[::-1]) - 1)
    geometry = Geometry.of(shape=shape, spacing_mm=spacing, origin_mm=CENTER + TILT @ first, direction=TILT)
    k, j, i = np.indices(shape)
    q = first + spacing * np.stack([i, j, k], axis=-1)
    values = np.where(np.linalg.norm(q, axis=-1) < BALL_MM, 400.0, 100.0)
    tube = (np.hypot(q[..., 0] - RIGHT[0], q[..., 1] - RIGHT[1]) < VESSEL_MM) & (q[..., 2] > 0)
    values[tube] = 900.0
    for chamber in (LEFT, RIGHT):
        values[np.linalg.norm(q - chamber, axis=-1) < CHAMBER_MM] = 1000.0
    values += np.random.Generator(np.random.PCG64(7)).normal(0, 15, shape)
    write_scan(Scan(np.round(values).astype(np.float32), geometry, "MR"), directory / "scan.nii")
    shell = np.abs(np.linalg.norm(q, axis=-1) - 16.0) < 1.0
    marked = (shell & (q[..., 2] < 0)) | (np.linalg.norm(q - [0, 0, -2], axis=-1) < 1.5)
    image = SimpleITK.GetImageFromArray(np.where(marked, 7, 0).astype(np.uint8))
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(geometry.origin_mm)
    image.SetDirection(TILT.ravel().tolist())
    SimpleITK.WriteImage(image, str(directory / "muscle.nrrd"), True)
    text = RECIPE.format(
        centre=world([0, 0, 1]),
        left=world(LEFT),
        right=world(RIGHT),
        vessel_low=world([8, 0, 10]),
        vessel_high=world([8, 0, 25]),
        a=world([-21, -20, -22]),
        b=world([-21, 20, -22]),
        c=world([-21, 20, 22]),
        d=world([-10, -20, 22]),
        end=world([8, 0, 22]),
        septum=world([0, 0, -2]),
        across=[float(value) for value in TILT @ np.array([1.0, 0, 0])],
        bottom=world([0, 0, -17]),
        bottom_pin=world([0, 12, -12]),
    )
    (directory / "recipe.toml").write_text(text)


def stage_outputs(directory: Path) -> Outputs:
    """Run every stage of each recipe; the arrays that each puts out: name of the recipe -> stage -> name -> array."""
    outputs: Outputs = {}
    # The report is no part of a case, and its pictures take most of the time.
    with patch("heartcase.pipeline.report.build_report.build_report", lambda _: ""):
        for name, write in {"watershed": write_inputs, **SMALL_RECIPES}.items():
            (directory / name).mkdir()
            write(directory / name)
            outputs[name] = _outputs_of_recipe(directory / name)
    return outputs


def inputs_of(recipe: str, stage: str) -> list[str]:
    """All stages that a stage of a recipe depends on."""
    inputs = INPUTS | INPUTS_ELSEWHERE.get(recipe, {})
    return [earlier for one in inputs[stage] for earlier in (one, *inputs_of(recipe, one))]


def _outputs_of_recipe(directory: Path) -> dict[str, Arrays]:
    recipe = parse_recipe((directory / "recipe.toml").read_text())
    runner = Runner(Cache(directory / "cache"), SilentListener(), force=False)
    stated, work = recipe, Work(recipe, directory, cache=runner.cache)

    def after(stage: str) -> None:
        if stage == "read":
            work.recipe = resolve_recipe(stated, work.outputs.scan.get())

    run_stages(runner, work, after=after)
    recipe, nodes = work.recipe, work.outputs
    scan, grid = nodes.scan.get(), nodes.grid.get()
    outputs = {
        "read": {"values": scan.values, "affine": scan.geometry.affine},
        "filter": {"values": nodes.filtered.get().values},
        "segment": {"labels": nodes.segmentation.get().labels},
        "walls": _of_structures(nodes.grown.get()),
        "grid": _arrays_of(grid) | {"affine": grid.geometry.affine},
    }
    if nodes.markers is not None:
        outputs["markers"] = {"labels": nodes.markers.get().labels}
    if recipe.edits:
        outputs["edit"] = _of_structures(nodes.structures.get())
    if nodes.surface is not None:
        outputs |= {"surface": _arrays_of(nodes.surface.get()), "map": _arrays_of(nodes.grid_map.get())}
    case = build_case(stated, directory=directory, out=directory / "out", cache=directory / "cache").case
    return outputs | {"bundle": _of_bundle(case)}


def _arrays_of(output: Any) -> Arrays:
    return {name: value for name, value in vars(output).items() if isinstance(value, np.ndarray)}


def _of_structures(structures: Structures) -> Arrays:
    """The stored fields, and who owns the points of a lattice twice as fine."""
    owner = ownership_on_lattice(structures, structures.geometry.refined(2))
    fields = {f"distance_mm/{value}": field for value, field in structures.distance_mm.items()}
    return fields | {"tissue_mm": owner.tissue_mm, "tissue": owner.tissue_label, "void": owner.void_label}


def _of_bundle(case: Path) -> Arrays:
    """What the files hold, whatever packed it; and the numbers of the manifest that a simulator goes by."""
    bundle = open_bundle(case)
    found: Arrays = {}
    for role in (entry.role for entry in bundle.manifest.files):
        path = bundle.path(role)
        if role in ARRAYS:
            # The padding between arrays has names that begin with an underscore.
            arrays = {name: array for name, array in load_file(path).items() if not name.startswith("_")}
            found |= {f"{role.value}/{name}": array for name, array in arrays.items()}
        elif role is FileRole.LABELS:
            found["labels"] = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(path)))
        else:
            found |= _of_glb(path)
    figures = bundle.manifest.simulation.model_dump()
    found["simulation"] = np.array([figures[name] for name in sorted(figures)], float)
    found["materials"] = np.array(
        [(one.label, one.youngs_modulus_kpa, one.density_kg_m3) for one in bundle.manifest.materials], float
    )
    found["grid_affine"] = bundle.manifest.grid_geometry.affine
    if bundle.manifest.scan_values is not None:
        stored = bundle.manifest.scan_values
        found["scan_values"] = np.array([stored.slope, stored.intercept, stored.error_max], float)
    return found


def _of_glb(path: Path) -> Arrays:
    gltf = pygltflib.GLTF2().load(str(path))
    blob = gltf.binary_blob()
    found: Arrays = {}
    kinds = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
    for number, accessor in enumerate(gltf.accessors):
        view = gltf.bufferViews[accessor.bufferView]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
        array = np.frombuffer(blob, kinds[accessor.componentType], accessor.count * width, start)
        found[f"render/{number}"] = array.reshape(accessor.count, width)
    for number, image in enumerate(gltf.images):
        view = gltf.bufferViews[image.bufferView]
        content = blob[view.byteOffset or 0 : (view.byteOffset or 0) + view.byteLength]
        found[f"render/image/{number}"] = np.array(Image.open(io.BytesIO(content)))
    return found


def sha256_of(arrays: Mapping[str, np.ndarray]) -> str:
    """Hash of a stage's arrays: names, types, shapes and every bit."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def summary_of(array: np.ndarray) -> dict[str, Any]:
    """Figures that hold across processors: type, shape, mean, deviation, four projections onto random directions."""
    values = array.astype(np.float64).ravel()
    random = np.random.Generator(np.random.PCG64(11))
    scale = np.sqrt(max(values.size, 1))
    centred = values - values.mean() if values.size else values
    return {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "mean": _short(values.mean()) if values.size else 0.0,
        "std": _short(values.std()) if values.size else 0.0,
        "projections": [_short(random.normal(size=values.size) @ centred / scale) for _ in range(4)],
    }


def _short(value: float) -> float:
    return float(f"{value:.7g}")
