"""Signed distance fields of the structures, and how they are read between voxels."""
