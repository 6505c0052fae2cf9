"""Simulated recordings of a virtual person with known parameters, for demonstration and tests."""
