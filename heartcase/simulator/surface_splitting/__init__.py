"""The visible surface of a cut lattice: split along the sheets, and tied to the nodes of each side."""
