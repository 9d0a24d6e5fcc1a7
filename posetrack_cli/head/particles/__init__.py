"""Particle filter over pose and deformation of a head (thesis, 3.3)."""
