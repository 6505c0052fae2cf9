"""Forces between the bones of a joint: what muscles press, which muscles nobody recorded, what peaks are."""
