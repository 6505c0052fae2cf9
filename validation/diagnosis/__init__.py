"""Accuracy of diagnoses of a blind bank, and statistics of the score on a development bank."""
