"""Report of fitted muscle paths, and sections on paths that a calibration changed."""
