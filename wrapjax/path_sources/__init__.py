"""A subject's muscle paths as the model takes them in: fitted polynomials or the exact engine."""
