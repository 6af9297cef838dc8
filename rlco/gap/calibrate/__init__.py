"""Calibration of what is always a little wrong in a model, and what it leaves open."""
