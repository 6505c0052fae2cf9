"""Inputs of a diagnosis: the calibrated model, its recordings, priors, and what effects are built from."""
