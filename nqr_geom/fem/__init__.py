"""Finite elements on polygons with holes: the independent reference for Laplace problems and the p-Laplacian."""
