"""The demonstration ``wrapjax demo``: calibration, recovery of wrapping cylinders, and a diagnosis."""
