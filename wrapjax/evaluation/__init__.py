"""Stored calibrations, and their predictions on other recordings."""
