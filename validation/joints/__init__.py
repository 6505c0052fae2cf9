"""Accuracy of personalised joints."""
