"""Muscle paths of the exact engine against OpenSim 4.6 and against minimisation by SciPy."""
