"""The patient's identity in a DICOM scan: read for the key file alone, and passed to nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pydicom

from heartcase.pipeline.formats.dicom.read import chosen_file
from heartcase.pipeline.formats.dicom.tags import quiet_pydicom
from heartcase.pipeline.formats.read_scan import is_dicom_source
from heartcase.schemas.errors import ScanError

__all__ = ["identity_of"]

_TAGS = {
    "PatientID": "patient_id",
    "IssuerOfPatientID": "issuer_of_patient_id",
    "PatientName": "patient_name",
    "PatientBirthDate": "patient_birth_date",
    "AccessionNumber": "accession_number",
    "StudyDate": "study_date",
    "StudyInstanceUID": "study_instance_uid",
    "SeriesInstanceUID": "series_instance_uid",
    "FrameOfReferenceUID": "frame_of_reference_uid",
}
"""Tag -> key in the key file."""


def identity_of(scan: Path, **choice: Any) -> dict[str, str]:
    """What a scan says of patient, study and series, and where it lies.

    Parameters
    ----------
    scan
        What :func:`heartcase.pipeline.formats.read_scan.read_scan` takes.
    choice
        ``series``, ``trigger_time_ms`` and ``echo_time_ms`` as there.

    Returns
    -------
    dict
        Key -> text, for what is stated; other formats than DICOM have the place of the scan alone.

    Raises
    ------
    ScanError
        The scan cannot be read.
    """
    found = {"scan": str(scan.resolve())}
    if not is_dicom_source(scan):
        return found
    file = chosen_file(scan, **{key: choice.get(key) for key in ("series", "trigger_time_ms", "echo_time_ms")})
    with quiet_pydicom():
        try:
            with file.open("rb") as stream:
                header = pydicom.dcmread(stream, stop_before_pixels=True, specific_tags=list(_TAGS), force=True)
            stated = {key: str(header.get(tag, "") or "").strip() for tag, key in _TAGS.items()}
        except Exception:  # pydicom raises errors of every kind on damaged files
            raise ScanError("its header cannot be read for the key file", place="scan") from None
    return found | {key: text for key, text in stated.items() if text}
