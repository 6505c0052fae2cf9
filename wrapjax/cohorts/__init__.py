"""Many subjects calibrated side by side."""
