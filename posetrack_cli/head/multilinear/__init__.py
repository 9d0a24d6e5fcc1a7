"""Multilinear face model: separate parameters for the identity and the expression of a face."""
