"""Many cases in one go: which recipes there are, which of their cases are stale, and building those on a cluster."""
