"""Bundle adjustment: who it is, and where the head was, from the points of several frames (thesis, 4.3)."""
