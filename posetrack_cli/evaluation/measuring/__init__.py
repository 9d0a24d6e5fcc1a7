"""Computation of metrics for results and pools of results."""
