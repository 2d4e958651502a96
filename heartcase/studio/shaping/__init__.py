"""Shaping: what a recipe says beside strokes, changed by hand: vessel ends, walls, edits, landmarks, materials."""
