"""What ``wrapjax demo`` does: calibration, recovery of moved wraps, diagnosis of a hidden effect."""
