"""The times of a recording: its clock, what its stamps hide, what rows repeat."""
