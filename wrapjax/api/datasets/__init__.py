"""Results as labelled arrays, for people who think in `xarray`: a module a kind of result."""
