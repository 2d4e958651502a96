"""Scans from image files that hold a whole volume: NIfTI, NRRD, MetaImage."""
