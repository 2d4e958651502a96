"""The engine of NVIDIA GPUs: many steps in one launch."""
