"""A virtual person whose parameters are known: the subject of the demo and of recovery tests."""
