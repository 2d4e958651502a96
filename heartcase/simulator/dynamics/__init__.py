"""How a lattice moves: the integrator, its longest stable step, energy and other measures."""
