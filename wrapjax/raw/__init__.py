"""A laboratory's raw files: markers, ground forces and EMG, read, checked and made ready for OpenSim's tools."""
