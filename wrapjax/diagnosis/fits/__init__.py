"""Fits of calibrated parameters with effects: to all cycles, to parts of them, and their verification."""
