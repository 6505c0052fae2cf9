"""A subject's model fitted to its moments: the problem, the calibration, and how sure it is."""
