"""The visible surface: how it follows the nodes, on CPU and GPU, and files of it."""
