"""Runs the cases of a folder of benchmarks, and shows time against error."""
