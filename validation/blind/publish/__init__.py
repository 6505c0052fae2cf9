"""What a README shows of a scored bank, from the scorer's JSON: a table with verdicts, and two pictures."""
