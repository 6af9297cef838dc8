"""The search on a servo's bench, where the servo's own numbers are fitted too."""
