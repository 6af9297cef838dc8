"""Figures, tables of numbers and the HTML report of a training run."""
