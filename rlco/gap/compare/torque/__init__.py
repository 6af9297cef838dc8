"""Measured joint torques against inverse dynamics."""
