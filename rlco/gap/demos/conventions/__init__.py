"""Conventions of a log: hypotheses of units, frames and signs, tested on its motion."""
