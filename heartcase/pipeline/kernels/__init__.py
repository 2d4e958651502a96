"""Kernels that several folders share: vectors, threads, nearest marked node, topology of voxel sets."""
