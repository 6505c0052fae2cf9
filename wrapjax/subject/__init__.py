"""Recorded data of one person: the subject folder, its signals and gait cycles, its muscles."""
