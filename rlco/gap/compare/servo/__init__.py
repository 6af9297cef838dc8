"""A servo with its firmware that drives a pendulum, as in BAM's recordings."""
