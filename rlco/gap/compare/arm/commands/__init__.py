"""Commands of a log: as sums of changes, late, missing, and guessed."""
