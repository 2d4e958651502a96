"""Flat minima that several labels mark: divided by the shortest ways, and mended where something was painted."""
