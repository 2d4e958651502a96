"""Painting and shaping a recipe: the recipe that is open, its pages, and what they ask for."""
