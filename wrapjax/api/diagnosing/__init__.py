"""What a calibrated model still lacks."""
