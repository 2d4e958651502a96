"""Sound files of every kind that heartcase reads, small enough to be read a thousand times."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nibabel
import numpy as np
import pydicom
import SimpleITK
import trimesh
from pydicom.uid import JPEG2000Lossless

from heartcase.pipeline.artifacts.serialise import artifact_to_bytes, load_artifact
from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.formats.labels.point_lists import read_point_lists
from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes
from heartcase.pipeline.formats.read_scan import list_series, read_labels, read_scan
from heartcase.pipeline.formats.write_images import write_scan, write_segmentation
from heartcase.pipeline.markers.load_markers import load_segmentation
from heartcase.schemas.bundle.approval import approval_state, approve_case
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recording.commands import CloseGrab, LeadGrab, Mark
from heartcase.schemas.recording.reader import check_recording, open_recording
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.load import load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.session.script import load_script
from heartcase.simulator.simulation import Simulation
from tests.factories import block_case
from tests.pipeline.formats.dicom_series import AXIAL, write_enhanced, write_series

__all__ = ["KINDS", "read", "write_sound"]

GEOMETRY = Geometry.of(shape=(6, 7, 8), spacing_mm=(1.0, 1.5, 2.0), origin_mm=(-4.0, 3.0, 10.0))
ROOT = Path(__file__).parents[2]


def _values() -> np.ndarray:
    return np.random.default_rng(1).normal(100.0, 20.0, GEOMETRY.shape).astype(np.float32)


def _segmentation() -> Segmentation:
    labels = np.random.default_rng(2).integers(0, 4, GEOMETRY.shape).astype(np.uint8)
    return Segmentation(labels, GEOMETRY, default_label_table())


def _scan_file(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / f"scan{suffix}"
        write_scan(Scan(_values(), GEOMETRY), path)
        return path

    return write


def _detached(suffix: str) -> Callable[[Path], Path]:
    """A header with its values in a file beside it."""

    def write(folder: Path) -> Path:
        image = SimpleITK.GetImageFromArray(_values())
        path = folder / f"scan{suffix}"
        SimpleITK.WriteImage(image, str(path), useCompression=False)
        return path

    return write


def _dicom(folder: Path) -> Path:
    positions = np.array([[-4.0, 3.0, 10.0 + 2.0 * k] for k in range(6)])
    write_series(folder / "series", _values().astype(np.int16), positions, pixel_spacing=(1.5, 1.0))
    return folder / "series"


def _enhanced(folder: Path) -> Path:
    positions = np.array([[-4.0, 3.0, 10.0 + 2.0 * k] for k in range(6)])
    path = folder / "enhanced.dcm"
    write_enhanced(path, _values().astype(np.int16), positions, orientation=AXIAL, spacing=(1.5, 1.0))
    return path


def _dicom_zip(folder: Path) -> Path:
    archive = shutil.make_archive(str(folder / "series"), "zip", _dicom(folder / "unpacked"))
    shutil.rmtree(folder / "unpacked")
    return Path(archive)


def _jpeg2000(folder: Path) -> Path:
    positions = np.array([[-4.0, 3.0, 10.0 + 2.0 * k] for k in range(6)])
    stored = np.random.default_rng(4).integers(0, 900, (6, 36, 34)).astype(np.uint16)
    for path in write_series(folder / "series", stored, positions):
        dataset = pydicom.dcmread(path)
        dataset.compress(JPEG2000Lossless, generate_instance_uid=False)
        dataset.save_as(path, enforce_file_format=True)
    return folder / "series"


def _four_axes(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        volumes = np.stack([_values() + n for n in range(3)]).astype(np.int16)
        path = folder / f"scan{suffix}"
        if suffix == ".nii.gz":
            nibabel.save(nibabel.Nifti1Image(volumes.T, np.diag([1.0, 1.5, 2.0, 1.0])), path)
        else:
            image = SimpleITK.GetImageFromArray(volumes, isVector=False)
            SimpleITK.WriteImage(image, str(path), useCompression=True)
        return path

    return write


def _read_frame(path: Path) -> Scan:
    return read_scan(path, frame=1)


def _labels(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / f"labels{suffix}"
        write_segmentation(_segmentation(), path)
        return path

    return write


def _dicom_seg(folder: Path) -> Path:
    path = folder / "labels.dcm"
    path.write_bytes(dicom_seg_bytes(_segmentation(), case_id="HC-1"))
    return path


def _stl_parts(folder: Path) -> Path:
    parts = folder / "parts"
    parts.mkdir()
    ball = trimesh.creation.icosphere(subdivisions=1, radius=3.0)
    ball.apply_translation(GEOMETRY.index_to_world((4.0, 3.0, 3.0)))
    (parts / "aorta.stl").write_bytes(ball.export(file_type="stl"))
    ball.apply_translation((2.0, 0.0, 0.0))
    (parts / "left ventricle.stl").write_text(ball.export(file_type="stl_ascii"))
    return parts


def _read_segmentation(path: Path) -> Any:
    return load_segmentation(path, {}, default_label_table(), GEOMETRY, others="ignore")


def _approvals(folder: Path) -> Path:
    write_bundle(folder / "block.case", block_case())
    for note in ("one", "two"):
        approve_case(folder / "block.case", role="cardiologist", note=note)
    return folder / "block.approvals.jsonl"


def _read_approvals(path: Path) -> Any:
    return approval_state(path.with_name("block.case"))


def _markups(folder: Path) -> Path:
    point = {"id": "1", "label": "left ventricle", "position": [1.0, 2.0, 3.0], "positionStatus": "defined"}
    markups = [
        {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [point, point]},
        {"type": "Curve", "coordinateSystem": "RAS", "name": "aorta", "controlPoints": [point] * 3},
    ]
    path = folder / "points.mrk.json"
    path.write_text(json.dumps({"markups": markups}))
    return path


def _recipe(folder: Path) -> Path:
    path = folder / "case.toml"
    path.write_bytes((ROOT / "sample_cases" / "chest_ct.toml").read_bytes())
    return path


def _script(folder: Path) -> Path:
    path = folder / "pull.toml"
    path.write_bytes((ROOT / "sample_cases" / "pull.toml").read_bytes())
    return path


def _case(folder: Path) -> Path:
    path = folder / "block.case"
    write_bundle(path, block_case(size=(6, 4, 4)))
    return path


def _recording(folder: Path) -> Path:
    session = OperatingSession(Simulation(block_model()))
    path = folder / "pull.recording"
    with Recorder(session, path, state_every_s=0.005):
        session.do(CloseGrab(name="hand", center_mm=(20.0, -14.0, 40.0), radius_mm=5.0))
        for number in range(3):
            session.do(LeadGrab(name="hand", offset_mm=(0.0, 0.0, 1.0 + number)))
            session.advance(20)
        session.undo()
        session.do(Mark(name="again"))
        session.advance(5)
    return path


def _read_recording(path: Path) -> None:
    check_recording(path)
    session = load_session(open_recording(path, partial=True), block_model())
    if session.end_step < 1000:
        for _ in session.play():
            pass
    open_recording(path)


@cache
def block_model() -> LatticeModel:
    """The lattice of the block that recordings are of."""
    with TemporaryDirectory() as folder:
        write_bundle(Path(folder) / "block.case", block_case(size=(6, 4, 4)))
        return load_case(Path(folder) / "block.case", needs=("grid",)).model


def _artifact(folder: Path) -> Path:
    path = folder / "scan.safetensors"
    path.write_bytes(artifact_to_bytes(Scan(_values(), GEOMETRY)))
    return path


def _read_case(path: Path) -> None:
    check_bundle(path)
    bundle = open_bundle(path)
    load_case(path, needs=("grid", "surface", "tangents", "colours", "picking"))
    for role in bundle.headers:
        bundle.arrays(role)


def _read_series(path: Path) -> None:
    list_series(path)
    read_scan(path, series="1")


KINDS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Any]]] = {
    "nifti": (_scan_file(".nii"), read_scan),
    "nifti-gz": (_scan_file(".nii.gz"), read_scan),
    "nrrd": (_scan_file(".nrrd"), read_scan),
    "nhdr": (_detached(".nhdr"), read_scan),
    "metaimage": (_scan_file(".mha"), read_scan),
    "mhd": (_detached(".mhd"), read_scan),
    "dicom": (_dicom, _read_series),
    "dicom-enhanced": (_enhanced, read_scan),
    "dicom-zip": (_dicom_zip, _read_series),
    "dicom-jpeg2000": (_jpeg2000, _read_series),
    "nifti-4d": (_four_axes(".nii.gz"), _read_frame),
    "nrrd-4d": (_four_axes(".nrrd"), _read_frame),
    "metaimage-4d": (_four_axes(".mha"), _read_frame),
    "stage-output": (_artifact, lambda path: load_artifact(path, Scan)),
    "markers-seg-nrrd": (_labels(".seg.nrrd"), read_labels),
    "markers-nifti": (_labels(".nii.gz"), read_labels),
    "markers-markups": (_markups, read_point_lists),
    "segmentation-dicom": (_dicom_seg, _read_segmentation),
    "segmentation-nrrd": (_labels(".seg.nrrd"), _read_segmentation),
    "segmentation-stl": (_stl_parts, _read_segmentation),
    "recipe": (_recipe, load_recipe),
    "script": (_script, load_script),
    "bundle": (_case, _read_case),
    "recording": (_recording, _read_recording),
    "approvals": (_approvals, _read_approvals),
}
"""Name -> what writes a sound file or folder of the kind, and what reads it."""


def write_sound(kind: str, folder: Path) -> Path:
    """Write a sound input of a kind into a folder."""
    return KINDS[kind][0](folder)


def read(kind: str, path: Path) -> None:
    """Read an input of a kind, as the commands do."""
    KINDS[kind][1](path)
