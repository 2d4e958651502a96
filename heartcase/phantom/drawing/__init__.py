"""What a person would draw on the synthetic heart: strokes, corrections, lines; and the recipe that holds them."""
