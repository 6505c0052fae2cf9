"""The virtual person, whose truth is known."""
