"""Forces and stiffness of cells: the formulas in float64, and the same for kernels."""
