"""Tissue that moves, and what is done to it: cut, held, stitched, patched; a running simulation is made of these."""
