"""Tracks of results and ground truth as arrays, read from files."""
