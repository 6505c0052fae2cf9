"""OpenSim: the only package that imports ``opensim``."""
