"""How errors in the inputs of inverse dynamics change the measured joint moments."""
