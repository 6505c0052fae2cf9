"""What differs between two conditions of one person."""
