"""Making the simulation grid: sampling, topology, repairs, supports, curvature."""
