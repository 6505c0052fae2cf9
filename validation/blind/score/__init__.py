"""Scorer of the blind bank: figures of accuracy of every answerer, with intervals."""
