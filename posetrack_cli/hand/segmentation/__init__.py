"""Which pixels of a depth image are a hand's."""

from posetrack_cli.hand.segmentation.detection import Detection, detect
