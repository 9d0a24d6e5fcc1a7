"""Where a one-camera track begins: pose and shape from the points of a few frames (thesis, 4.4.1)."""
