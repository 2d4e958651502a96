"""Outputs of stages on disk: as bytes and back, and the build's cache of them."""
