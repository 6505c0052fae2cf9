"""The blind bank: cases with known causes from a simulator that shares nothing with the diagnosis.

Nothing here imports the package that is judged; a test holds that.
"""
