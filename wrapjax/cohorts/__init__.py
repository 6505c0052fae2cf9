"""Calibration and diagnosis of many subjects in parallel."""
