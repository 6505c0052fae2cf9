"""Several methods and persons, side by side."""
