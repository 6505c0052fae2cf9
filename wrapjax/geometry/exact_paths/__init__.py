"""Exact muscle paths over several points and surfaces, with derivatives by all that may be adjusted."""
