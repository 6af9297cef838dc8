"""Options, the run's folder and its files, and how a recipe is run."""
