"""A parametric heart of analytic shapes, its exact truth, and synthetic scans of it."""
