"""Compiled replay of a task's recordings under robosuite's controller."""
