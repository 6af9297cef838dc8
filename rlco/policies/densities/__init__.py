"""Log-probabilities of samples that are made step by step: tokens, denoising chains."""
