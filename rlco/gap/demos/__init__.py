"""Logs of a task's own actions: their conventions and their replay in simulation."""
