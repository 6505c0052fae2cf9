"""Statistical comparison of calibration methods on the same subjects."""
