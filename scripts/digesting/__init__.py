"""Digests of everything that the commands write, to compare two states of the code."""
