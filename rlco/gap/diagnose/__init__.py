"""Localise the disagreement of simulation and measurement, and advise recordings."""
