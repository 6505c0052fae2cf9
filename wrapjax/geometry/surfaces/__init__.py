"""Wrapping surfaces of every kind: the path of one segment round one of them."""
