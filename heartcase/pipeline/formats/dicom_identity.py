"""Who a DICOM scan is of: read for the key file alone, on the user's word, and passed to nothing else."""

from __future__ import annotations

from pathlib import Path

import pydicom

from heartcase.pipeline.formats.dicom_headers import quiet_pydicom
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


def identity_of(file: Path) -> dict[str, str]:
    """What a DICOM file says of patient, study and series.

    Parameters
    ----------
    file
        One image of the series.

    Returns
    -------
    dict
        Key -> text, for what is stated.

    Raises
    ------
    ScanError
        The file cannot be read.
    """
    with quiet_pydicom():
        try:
            header = pydicom.dcmread(file, stop_before_pixels=True, specific_tags=list(_TAGS), force=True)
            found = {key: str(header.get(tag, "") or "").strip() for tag, key in _TAGS.items()}
        except Exception:  # pydicom raises errors of every kind on damaged files
            raise ScanError("its header cannot be read for the key file", place="scan") from None
    return {key: text for key, text in found.items() if text}
