"""Sources of a subject's muscle paths for the model: fitted polynomials or the exact engine."""
