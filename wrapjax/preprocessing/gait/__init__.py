"""Contacts of the feet with plates and ground, gait events, steps, and cycles unlike the others."""
