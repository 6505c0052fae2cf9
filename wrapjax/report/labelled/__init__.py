"""xarray datasets of results."""
