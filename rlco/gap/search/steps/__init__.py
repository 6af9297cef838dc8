"""The steps of a search: each takes a state and returns the next."""
