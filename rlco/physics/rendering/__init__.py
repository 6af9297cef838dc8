"""Camera images of a model, rendered off screen."""
