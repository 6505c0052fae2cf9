"""The scorer: opens truth once, and says of every answerer what it got right, with intervals."""
