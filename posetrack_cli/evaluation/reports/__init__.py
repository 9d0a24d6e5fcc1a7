"""Evaluations as tables, JSON and CSV."""
