"""What is said in the end: probabilities, the verdict, and which experiment would tell more."""
