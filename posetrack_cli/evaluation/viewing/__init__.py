"""Rendering of estimates onto the recorded frames, as images and video."""
