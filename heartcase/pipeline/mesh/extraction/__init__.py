"""Triangles from distance fields: marching cubes, tags, and normals of the fields."""
