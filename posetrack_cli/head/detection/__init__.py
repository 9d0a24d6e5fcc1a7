"""Faces and their ten points in one grey image."""
