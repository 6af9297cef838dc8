"""Small policies of the three kinds: Gaussian, token, flow; and their files."""
