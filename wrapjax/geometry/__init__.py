"""Skeleton kinematics, wrap surfaces, muscle paths: length, rate and moment arms, exact or by polynomials."""
