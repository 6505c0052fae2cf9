"""Calibration of the model to a subject: objective, penalties, limits, solvers, uncertainty."""
