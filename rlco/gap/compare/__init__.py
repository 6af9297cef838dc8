"""Residuals between recordings and simulation: one package for each kind of log."""
