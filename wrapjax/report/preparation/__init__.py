"""The page of a prepared subject: what was recorded, to look at before anything is calculated from it."""
