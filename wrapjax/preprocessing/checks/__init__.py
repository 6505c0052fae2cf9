"""Checks of recordings: consistency, EMG channels, markers, and what may spoil a result."""
