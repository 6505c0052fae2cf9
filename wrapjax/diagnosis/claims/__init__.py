"""What may be said: probabilities, decisions, the four gates, and advice on the next recording."""
