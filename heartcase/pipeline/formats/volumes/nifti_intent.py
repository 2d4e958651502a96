"""What the header of a NIfTI file says its values are: ``intent_code`` of NIfTI-1."""

from __future__ import annotations

__all__ = ["INTENT_AT", "LABEL_INTENT"]

INTENT_AT = 68
"""Byte at which the code begins; it has two."""
LABEL_INTENT = 1002
"""NIFTI_INTENT_LABEL: each value is the number of a structure."""
