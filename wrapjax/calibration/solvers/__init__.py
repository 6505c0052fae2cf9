"""Solvers of least squares with bounds and inequality constraints, multistart, checkpoints."""
