"""Commands that are late, and commands that are missing."""
