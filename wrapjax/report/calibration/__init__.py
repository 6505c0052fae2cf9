"""Report of a calibration, of its evaluation, and of initial lengths."""
