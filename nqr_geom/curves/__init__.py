"""Curves that people bring: exact winding numbers and distances, and the same as integrals."""
