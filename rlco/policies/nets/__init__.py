"""Networks that policies are made of: encoders, perceptrons, transformers."""
