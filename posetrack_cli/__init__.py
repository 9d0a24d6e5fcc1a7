"""posetrack: batch tracking of hands and heads in recorded depth and video."""

import os

from posetrack_cli.limits import IMAGE_PIXELS

# OpenCV reads it as it is loaded, which is later; its own bound is 32 times higher.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(IMAGE_PIXELS))
