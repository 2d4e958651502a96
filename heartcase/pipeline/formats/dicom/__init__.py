"""Scans from DICOM: which files belong together, what their headers say, their pixels, and the stack that they make."""
