"""Evaluation of results: metrics, comparisons, gates, reports and views."""
