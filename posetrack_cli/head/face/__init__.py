"""Basics of a face: ten feature points, poses, shapes, and templates of the points in images."""
