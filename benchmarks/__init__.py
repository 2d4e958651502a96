"""Measurements: cases as data (``cases.toml``), a module for each thing that is measured, and the runner."""
