"""One module per file format, and their shared columns and headers."""
