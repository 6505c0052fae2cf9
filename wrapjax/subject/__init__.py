"""Recorded data of one leg: the subject folder and its settings, signals, gait cycles and muscles."""
