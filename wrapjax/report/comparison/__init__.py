"""Report of a comparison of methods."""
