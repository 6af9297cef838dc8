"""Learning in several processes: who is one of them, and what they share."""
