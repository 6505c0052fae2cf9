"""Several calibration methods compared on the same subjects, with statistics."""
