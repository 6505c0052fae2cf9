"""The catalogued effects, one module a family."""
