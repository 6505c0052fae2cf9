"""Finished calibrations read back and tested on other trials."""
