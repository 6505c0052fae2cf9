"""A calibrated model on other cycles: what it predicts, its errors, and the folder they are written to."""
