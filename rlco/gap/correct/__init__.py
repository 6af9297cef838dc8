"""The corrected model: the user's MJCF file with the effects applied, and its diff."""
