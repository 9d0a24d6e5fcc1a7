"""Gates, baselines and comparisons of evaluations."""
