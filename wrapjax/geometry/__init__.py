"""Kinematics, wrapping surfaces and muscle paths: length, rate and moment arms, exact or by polynomials."""
