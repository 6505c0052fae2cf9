"""Diagnoses of recorded walking with known errors added to its files."""
