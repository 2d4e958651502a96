"""Cells' samples as bits: what hangs together in each, and what a further sheet changes of it; kernels alone."""
