"""The golden case: a small lopsided piece of tissue, and what every reader of a bundle must find in it."""
