"""Model of one muscle: excitation, activation dynamics, Hill curves, rigid and compliant tendons."""
