"""Bounded least squares with inequality constraints, from several starting points, resumable."""
