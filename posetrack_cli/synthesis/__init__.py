"""Synthetic recordings of hands and heads, with exact truth."""
