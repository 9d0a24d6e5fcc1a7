"""Local fits of a hand's pose to a depth image: a software rasteriser and Gauss-Newton, compiled."""
