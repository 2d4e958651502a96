"""The engine of the CPU: float32 in vectors of 8 lanes, on all cores."""
