"""The report of a fit: how well polynomials follow muscle paths, and how cylinders were sampled."""
