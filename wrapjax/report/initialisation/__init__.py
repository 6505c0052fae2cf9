"""The page of lengths to start from."""
