"""Rubbish for everything that reads a file: what is neither read nor refused in a sentence is a finding."""
