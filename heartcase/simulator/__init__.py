"""From case to motion: the spring lattice, its kernels, instruments and surface."""
