"""Calibration of cameras from images of a board: detection, intrinsics, places, errors."""
