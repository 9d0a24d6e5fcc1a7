"""Heads: pose and face deformation from images of one or more calibrated cameras."""
