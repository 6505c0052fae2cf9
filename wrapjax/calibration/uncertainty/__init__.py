"""How well the recordings determine calibrated parameters."""
