"""Calibrate EMG-driven musculoskeletal models with exact gradients."""
