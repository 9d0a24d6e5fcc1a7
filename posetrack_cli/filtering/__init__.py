"""Bayesian filtering on arrays: log-weights, resampling, Kalman recursions, particle filters."""
