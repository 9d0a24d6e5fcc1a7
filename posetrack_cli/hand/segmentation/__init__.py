"""Which pixels of a depth image are a hand's.

``segment`` tells hand, forearm, other surfaces and missing readings apart around a prediction, once a frame;
``detect`` finds hands in a whole image without one. Both read surfaces: neighbouring readings without a jump
of depth between them. A missing reading is of no surface, and no background either.
"""

from posetrack_cli.hand.segmentation.around_prediction import Label, Segmentation, segment
from posetrack_cli.hand.segmentation.detection import Detection, detect
from posetrack_cli.hand.segmentation.prediction import PredictedHand

__all__ = ["Detection", "Label", "PredictedHand", "Segmentation", "detect", "segment"]
