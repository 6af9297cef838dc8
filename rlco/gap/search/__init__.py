"""The search for missing effects, and its verdict."""
