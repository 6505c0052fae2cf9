"""The report of contact forces: a page, its figures, and numbers for programs."""
