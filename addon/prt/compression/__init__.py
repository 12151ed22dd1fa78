"""Bakes in fewer numbers."""
