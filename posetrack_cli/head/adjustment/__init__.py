"""Bundle adjustment of identity and head poses to the points of several frames (thesis, 4.3)."""
