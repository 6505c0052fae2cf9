"""Polynomials that stand for muscle paths, and the wrap parameters for which they hold."""
