"""Winding numbers, distances and integrals on curves people bring."""

__version__ = "0.1.0"
