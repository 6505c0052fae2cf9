"""Access to OpenSim: reads and writes models, computes muscle paths, and runs OpenSim's tools."""
