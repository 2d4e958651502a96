"""The cell lattice: nodes, springs, law of force, and what changes while it moves."""
