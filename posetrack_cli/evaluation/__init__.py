"""Metrics of a result against truth."""
