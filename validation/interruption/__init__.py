"""Commands that are killed at random times and resumed, compared with uninterrupted runs."""
