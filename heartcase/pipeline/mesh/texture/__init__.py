"""Texture coordinates and normal maps of a surface."""
