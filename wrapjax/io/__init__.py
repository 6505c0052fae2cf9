"""Files, written whole or not at all: OpenSim tables and models, TOML, XML, JSON, arrays, locks."""
