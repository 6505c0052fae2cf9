"""Coverage-guided fuzzing of all file readers: every input must be read or rejected with a message."""
