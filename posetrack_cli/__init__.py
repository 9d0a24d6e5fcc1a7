"""posetrack: batch tracking of hands and heads in recorded depth and video."""

__version__ = "0.1.0"
