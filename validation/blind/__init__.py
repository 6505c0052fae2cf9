"""The blind bank: simulated cases with known causes, and the scorer of diagnoses of these cases.

Nothing here imports `wrapjax`, so that the simulator and the diagnosis share no formula (checked by
``tests/validation/test_independence.py``).
"""
