"""Refinement of the particle filter's pose, deformation and points by image patches."""
