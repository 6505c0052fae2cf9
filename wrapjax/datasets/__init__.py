"""Public recordings for download, and the virtual person."""
