"""Commands killed at random moments, taken up again, and compared with undisturbed ones."""
