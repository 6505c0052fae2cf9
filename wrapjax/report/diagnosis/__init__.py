"""Reports of a diagnosis, of a difference between conditions, and of a protocol."""
