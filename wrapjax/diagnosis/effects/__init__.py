"""The catalogue of unmodelled effects, each off at zero."""
