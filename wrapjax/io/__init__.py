"""Reading and writing files: OpenSim tables and models, TOML, XML, JSON, arrays; atomic writing, locks."""
