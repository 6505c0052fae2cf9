"""Where muscle paths come from: polynomials, or the exact engine."""
