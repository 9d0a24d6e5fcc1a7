"""posetrack: batch tracking of hands and heads in recorded depth and video."""

import os

from posetrack_cli.limits import IMAGE_PIXELS

# Must be set before cv2 is imported; OpenCV's own default is 32 times higher.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(IMAGE_PIXELS))
