"""Public recordings to download, and the virtual person."""
