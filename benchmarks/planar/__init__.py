"""A planar pushing task in NumPy, fast enough for a map of hundreds of runs."""
