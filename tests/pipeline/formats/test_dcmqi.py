"""DICOM SEG to and from dcmqi, the converter inside 3D Slicer's reader of such objects."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes
from heartcase.pipeline.formats.read_scan import read_labels
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from tests.pipeline.formats.dicom_series import write_series

DIRECTION = Rotation.from_euler("xyz", [20, -30, 10], degrees=True).as_matrix()
OBLIQUE = Geometry.of(
    shape=(9, 11, 13), spacing_mm=(0.7, 1.1, 2.3), origin_mm=(-31.5, 12.25, 700.125), direction=DIRECTION
)


def program(name: str) -> str:
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        pytest.skip("dcmqi is not installed: pip install dcmqi")
    return found


def labels() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 10, OBLIQUE.shape).astype(np.uint8)


def run(*command: object) -> None:
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_heartcase_writes(tmp_path: Path) -> None:
    seg = tmp_path / "labels.dcm"
    seg.write_bytes(dicom_seg_bytes(Segmentation(labels(), OBLIQUE, default_label_table()), case_id="HC-1"))
    prefix = ("--outputDirectory", tmp_path, "--prefix", "o", "--mergeSegments", "-t", "nrrd")
    run(program("segimage2itkimage"), "--inputDICOM", seg, *prefix)
    image = SimpleITK.ReadImage(str(tmp_path / "o-1.nrrd"))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(image), labels())
    np.testing.assert_allclose(image.GetOrigin(), OBLIQUE.origin_mm, atol=1e-4)
    np.testing.assert_allclose(image.GetSpacing(), OBLIQUE.spacing_mm, atol=1e-4)
    np.testing.assert_allclose(image.GetDirection(), DIRECTION.ravel(), atol=1e-5)
    (segments,) = json.loads((tmp_path / "o-meta.json").read_text())["segmentAttributes"]
    named = {one["labelID"]: one["SegmentLabel"] for one in segments}
    assert named == {label.value: label.name for label in default_label_table() if label.value}


def test_what_dcmqi_writes(tmp_path: Path) -> None:
    positions = np.array([OBLIQUE.index_to_world((0, 0, k)) for k in range(OBLIQUE.size[2])])
    files = write_series(
        tmp_path / "series",
        np.zeros(OBLIQUE.shape, np.int16),
        positions,
        orientation=(*DIRECTION[:, 0], *DIRECTION[:, 1]),
        pixel_spacing=(1.1, 0.7),
        StudyDate="",
        PatientID="",
        FrameOfReferenceUID="1.2.826.0.1.3680043.8.498.5",
    )
    image = SimpleITK.GetImageFromArray(labels())
    image.SetOrigin(OBLIQUE.origin_mm)
    image.SetSpacing(OBLIQUE.spacing_mm)
    image.SetDirection(DIRECTION.ravel().tolist())
    SimpleITK.WriteImage(image, str(tmp_path / "labels.nrrd"))
    code = {"CodeValue": "91723000", "CodingSchemeDesignator": "SCT", "CodeMeaning": "Anatomical Structure"}
    segments = [
        {
            "labelID": label.value,
            "SegmentLabel": label.name,
            "SegmentDescription": label.name,
            "SegmentAlgorithmType": "MANUAL",
            "SegmentedPropertyCategoryCodeSequence": code,
            "SegmentedPropertyTypeCodeSequence": code,
        }
        for label in default_label_table()
        if label.value
    ]
    meta = {"ContentCreatorName": "R^R", "SeriesNumber": "7", "InstanceNumber": "1", "segmentAttributes": [segments]}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    run(
        *(program("itkimage2segimage"), "--inputImageList", tmp_path / "labels.nrrd"),
        *("--inputDICOMList", ",".join(str(file) for file in files), "--inputMetadata", tmp_path / "meta.json"),
        *("--outputDICOM", tmp_path / "theirs.dcm"),
    )
    found = read_labels(tmp_path / "theirs.dcm")
    assert found.geometry.matches(OBLIQUE)
    np.testing.assert_array_equal(found.values, labels())
