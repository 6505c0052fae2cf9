"""Calibration of the model to a person: objective, penalties, limits, solvers, uncertainty."""
