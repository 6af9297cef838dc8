"""Position-controlled arms: residuals of measured against simulated joint positions."""
