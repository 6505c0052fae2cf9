"""Which unmodelled effect best explains the remaining error, among those that the data can test."""
