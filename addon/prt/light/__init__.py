"""Distant light: pictures to coefficients, and what those leave out."""
