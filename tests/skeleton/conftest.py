"""Fixtures of the tests in this folder."""

from tests.osim.odd import odd_model as odd_model
