"""The report of a diagnosis: where the moment error is, what explains it best, and how far it shrinks."""
