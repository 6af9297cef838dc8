"""LeRobot's pi0.5 and SmolVLA, and their checkpoint folders."""
