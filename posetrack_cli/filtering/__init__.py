"""Bayesian filtering over plain arrays: log-weights, resampling, Kalman steps, particle filters."""
