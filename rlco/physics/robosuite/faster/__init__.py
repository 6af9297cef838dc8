"""What robosuite does, without its unnecessary work."""
