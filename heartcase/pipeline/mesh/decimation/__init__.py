"""Fewer triangles with the same shape: edge collapse by quadrics, and the distance that it costs."""
