"""Where a head's track begins: the ten points in space from images of calibrated cameras."""
