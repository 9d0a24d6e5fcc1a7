"""Likelihood of a pose and its optimisation."""
