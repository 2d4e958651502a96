"""The scan as an image: region of interest, noise, smoothing, gradient, and the landscape of the watershed."""
