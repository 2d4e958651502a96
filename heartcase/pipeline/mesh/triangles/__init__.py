"""Triangle meshes as such: half edges, a spatial index, intersections, distances, thickness."""
