"""OpenVLA out of transformers' parts."""
