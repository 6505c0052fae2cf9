"""Uncertainty of calibrated parameters: noise of the moments, posterior, intervals, identifiability."""
