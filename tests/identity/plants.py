"""Scans and markers with made-up names, dates and identifiers in every place that can hold text."""

from __future__ import annotations

import json
import struct
from itertools import count
from pathlib import Path

import nibabel
import numpy as np
import pydicom
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence

from heartcase.pipeline.data import Scan
from heartcase.schemas.geometry import Geometry
from tests.pipeline.formats.dicom_series import write_series

NAME = "ZqWxPtKj"
"""What every planted name starts with, in any case of letters."""
DATE = "19370521"
TIME = "035947.271828"
UID_PART = "31415926535897932384"
TOKENS = (NAME, DATE, "1937-05-21", TIME, UID_PART)
"""What must be found nowhere."""

FOLDER = f"{NAME} folder^of {DATE}"
FILE = f"{NAME}_file_{DATE}"

READ_BY_THE_READER = {
    *("SpecificCharacterSet", "SOPClassUID", "Modality", "PhotometricInterpretation", "PixelData", "ImageType"),
    *("FloatPixelData", "DoubleFloatPixelData", "PixelPresentation", "VolumetricProperties", "PresentationLUTShape"),
}
"""Tags whose words decide whether there is a scan at all."""
_TEXT = {"LO": 64, "SH": 16, "PN": 64, "ST": 200, "LT": 200, "UT": 200, "UC": 200, "UR": 200, "AE": 16, "CS": 16}

_numbers = count()


def token(length: int = 64, *, upper: bool = False) -> str:
    """A planted name that occurs once."""
    text = f"{NAME}{next(_numbers):05d}"[:length]
    return text.upper() if upper else text


def _planted(vr: str) -> str | None:
    if vr in _TEXT:
        return token(_TEXT[vr], upper=vr == "CS")
    known = {"DA": DATE, "DT": DATE + TIME, "TM": TIME, "UI": f"1.2.826.0.1.3680043.8.498.{UID_PART}"}
    return known.get(vr)


def plant_in(dataset: Dataset) -> int:
    """Fill every text, date, time and identifier tag of the standard that is not there yet; returns how many."""
    planted = 0
    for tag, (vr, _, _, _, keyword) in pydicom.datadict.DicomDictionary.items():
        group = tag >> 16
        if keyword in READ_BY_THE_READER or not keyword or group in (0x0000, 0x0002, 0x0004, 0xFFFE):
            continue
        text = _planted(vr)
        if text is not None and tag not in dataset:
            dataset.add_new(tag, vr, text)
            planted += 1
    for keyword in ("PatientName", "PatientID", "PatientBirthDate", "StudyDescription", "SeriesDescription"):
        assert keyword in dataset
    inner = Dataset()
    inner.PatientName, inner.RequestedProcedureDescription, inner.StudyDate = token(), token(), DATE
    dataset.RequestAttributesSequence = Sequence([inner])
    block = dataset.private_block(0x0011, token(), create=True)
    block.add_new(0x01, "LO", token())
    block.add_new(0x02, "OB", token().encode())
    block.add_new(0x03, "SQ", Sequence([inner]))
    unknown = dataset.private_block(0x0029, token(), create=True)
    unknown.add_new(0x10, "UN", token().encode().ljust(64))
    return planted + 10


def write_dicom(folder: Path, scan: Scan) -> None:
    """Write a planted series of axial slices, one file each, in a folder and under names that tell the patient."""
    geometry = scan.geometry
    positions = np.array([geometry.index_to_world((0, 0, k)) for k in range(geometry.size[2])])
    stored = np.clip(np.round(scan.values), -2000, 30000).astype(np.int16)
    uid = "1.2.826.0.1.3680043.8.498"
    paths = write_series(folder, stored, positions, pixel_spacing=geometry.spacing_mm[:2], modality="MR")
    for number, path in enumerate(paths):
        dataset = pydicom.dcmread(path)
        dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = f"{uid}.{number}.{UID_PART}"
        dataset.SeriesInstanceUID = dataset.StudyInstanceUID = f"{uid}.{UID_PART}.{DATE}"
        dataset.FrameOfReferenceUID = f"{uid}.777.{UID_PART}"
        dataset.file_meta.SourceApplicationEntityTitle = token(16)
        assert plant_in(dataset) > 1000
        path.unlink()
        dataset.save_as(folder / f"{FILE}_{number:03d}.dcm", enforce_file_format=True)


def write_nifti(path: Path, scan: Scan) -> None:
    """Write a NIfTI file with names in all its text fields and in an extension."""
    affine = np.diag([-1.0, -1.0, 1.0, 1.0]) @ scan.geometry.affine
    image = nibabel.Nifti1Image(scan.values.transpose(2, 1, 0), affine)
    for field in ("descrip", "db_name", "aux_file", "intent_name"):
        image.header[field] = token(16).encode()
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", token().encode()))
    nibabel.save(image, path)


def write_nrrd(path: Path, values: np.ndarray, geometry: Geometry, *, segments: list[tuple[str, int]] = ()) -> None:
    """Write an NRRD file with names in comments, content, keys, key-value pairs, and segments if there are any."""
    spacing, direction = geometry.spacing_mm, geometry.direction_matrix
    vectors = " ".join("(" + ",".join(f"{v:.17g}" for v in direction[:, a] * spacing[a]) + ")" for a in range(3))
    kinds = {"float32": "float", "uint8": "unsigned char"}
    lines = [
        "NRRD0005",
        f"# {token()}",
        f"type: {kinds[values.dtype.name]}",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {' '.join(str(n) for n in geometry.size)}",
        f"space directions: {vectors}",
        "kinds: domain domain domain",
        "endian: little",
        "encoding: raw",
        f"content: {token()}",
        f"space origin: ({','.join(f'{v:.17g}' for v in geometry.origin_mm)})",
        f"PatientName:={token()}",
        f"{token()}:=value {DATE}",
    ]
    for index, (name, value) in enumerate(segments):
        lines += [
            f"Segment{index}_ID:={token()}",
            f"Segment{index}_Name:={name}",
            f"Segment{index}_LabelValue:={value}",
            f"Segment{index}_Layer:=0",
            f"Segment{index}_Tags:=Segmentation.Status:{token()}|",
        ]
    path.write_bytes("\n".join(lines).encode() + b"\n\n" + np.ascontiguousarray(values).tobytes())


def write_metaimage(path: Path, scan: Scan) -> None:
    """Write a MetaImage file with names in its text fields."""
    geometry = scan.geometry
    lines = {
        "ObjectType": "Image",
        "Comment": token(),
        "ObjectSubType": token(),
        "Name": token(),
        "TransformType": "Rigid",
        "NDims": 3,
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "TransformMatrix": " ".join(f"{v:.17g}" for v in geometry.direction_matrix.T.ravel()),
        "Offset": " ".join(f"{v:.17g}" for v in geometry.origin_mm),
        "ElementSpacing": " ".join(f"{v:.17g}" for v in geometry.spacing_mm),
        "DimSize": " ".join(str(n) for n in geometry.size),
        "ElementType": "MET_FLOAT",
        "ElementDataFile": "LOCAL",
    }
    text = "".join(f"{key} = {value}\n" for key, value in lines.items())
    path.write_bytes(text.encode() + scan.values.astype("<f4").tobytes())


def write_markups(path: Path, lists: list[tuple[str, list[list[float]]]]) -> None:
    """Write a 3D Slicer markup file with a planted name and description for every list and point."""
    markups = [
        {
            "type": "Curve",
            "coordinateSystem": "LPS",
            "name": name,
            "controlPoints": [
                {"id": str(n), "label": token(), "description": token(), "position": point, "positionStatus": "defined"}
                for n, point in enumerate(points)
            ],
        }
        for name, points in lists
    ]
    schema = f"https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/{token()}"
    path.write_text(json.dumps({"@schema": schema, "markups": markups}))


def write_stl(path: Path, radius_mm: float) -> None:
    """Write a closed octahedron with a planted name in its header."""
    x = radius_mm
    corners = np.array([[x, 0, 0], [-x, 0, 0], [0, x, 0], [0, -x, 0], [0, 0, x], [0, 0, -x]], dtype="<f4")
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    body = b"".join(struct.pack("<3f", 0, 0, 0) + corners[list(face)].tobytes() + b"\0\0" for face in faces)
    path.write_bytes(token().encode().ljust(80) + struct.pack("<I", len(faces)) + body)
