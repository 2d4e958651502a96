"""Walls grown around cavities (thesis 11.2.3), and septa between those that a heart does not join."""
