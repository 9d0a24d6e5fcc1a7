"""Synthetic recordings of hands and heads with exact ground truth."""
