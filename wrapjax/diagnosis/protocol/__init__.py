"""What to record next: trials that tell effects apart, simulated with the subject's own model."""
