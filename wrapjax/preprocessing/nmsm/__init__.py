"""Projects of the NMSM Pipeline."""
