"""Personalisation of a model's joints from markers."""
