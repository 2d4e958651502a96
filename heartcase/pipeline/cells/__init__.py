"""The simulation grid and what ties the surface to it: sampling, repairs, supports, curvature, map, picking."""
