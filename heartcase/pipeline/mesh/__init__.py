"""Making the surface: extraction, decimation, texture, and what is measured of triangles."""
