"""The 21 points of a hand in files of keypoints: ours, which are MediaPipe's in its order."""

from __future__ import annotations

from posetrack_cli.hand.anatomy import JOINT_NAMES
from posetrack_cli.recording.keypoints.kind import PointKind, same_order

POINTS = len(JOINT_NAMES)


def _plain(name: str) -> str:
    """MediaPipe's name as ours: ``HandLandmark.INDEX_FINGER_TIP``, ``PINKY_MCP``."""
    return name.removeprefix("handlandmark.").replace("_finger", "").replace("pinky", "little")


HAND_POINTS = PointKind(
    subject="hand",
    names=JOINT_NAMES,
    counted={POINTS: same_order(POINTS)},
    several=("hands", "multi_hand_landmarks", "hand_landmarks", "handLandmarks"),
    command="posetrack hand run --help",
    plain=_plain,
    ends=("wrist", "tip of the little finger"),
)
