"""Laplace problems on polygons: walk on spheres, and a deterministic solver that tells how far off it is."""
