"""What a recipe, a label table, a bundle and a script are, and the errors."""
