"""Joint contact forces of a calibrated model."""
