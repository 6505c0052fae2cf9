"""Accuracy of calibrated moment arms, parameter intervals, written models and contact forces."""
