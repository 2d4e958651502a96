"""Cuts: what a swept blade parts is decided at rest, on whole numbers, and makes cells and nodes of its own."""
