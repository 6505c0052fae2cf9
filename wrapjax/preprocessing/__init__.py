"""Preparation of a subject folder from a laboratory's raw files or from a project of the NMSM Pipeline."""
