"""A laboratory's raw files: markers, ground forces and EMG, read, checked, ready for OpenSim's tools."""
