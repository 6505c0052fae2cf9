"""Table with verdicts and two figures of a scored bank, from the JSON file of the scorer."""
