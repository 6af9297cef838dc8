"""Detect models whose simulation is unstable before a search, and advise on causes."""
