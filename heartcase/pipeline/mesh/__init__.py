"""Making the surface: extraction, decimation, atlas, normal map, GLB, measures."""
