"""Patches: sheets that are cut to a closed outline, laid out flat, and sewn on along it."""
