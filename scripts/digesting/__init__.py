"""Digests of all command output, to compare two states of the code."""
