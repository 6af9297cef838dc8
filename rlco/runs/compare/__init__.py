"""A grid of runs from one YAML file: planned, run, and cached as small files."""
