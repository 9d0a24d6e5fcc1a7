"""The 21 points of a hand in files of keypoints: ours, which are MediaPipe's in its order."""

from __future__ import annotations

import re

from posetrack_cli.hand.anatomy import JOINT_NAMES
from posetrack_cli.recording.keypoints.kind import PointKind, same_order

POINTS = len(JOINT_NAMES)


_THEIRS = re.compile(
    r"(?:(?:left|right|l|r)_)?(?:hand_)?(thumb|index|middle|ring|little)_?(cmc|mcp|ip|pip|dip|tip|[1-4])"
)
_THUMB, _FINGER = ("cmc", "mcp", "ip", "tip"), ("mcp", "pip", "dip", "tip")


def _plain(name: str) -> str:
    """Return another program's name as ours.

    MediaPipe has ``HandLandmark.INDEX_FINGER_TIP`` and ``PINKY_MCP``, COCO ``forefinger1`` and ``thumb4``;
    annotators write ``IndexMCP``.
    """
    plain = name.removeprefix("handlandmark.").replace("forefinger", "index").replace("pinky", "little")
    plain = plain.replace("_finger", "")
    if plain.endswith("hand_root"):
        return "wrist"
    found = _THEIRS.fullmatch(plain)
    if found is None:
        return plain
    finger, joint = found.groups()
    number = int(joint) - 1 if joint.isdecimal() else -1
    return f"{finger}_{(_THUMB if finger == 'thumb' else _FINGER)[number] if number >= 0 else joint}"


HAND_POINTS = PointKind(
    subject="hand",
    names=JOINT_NAMES,
    counted={POINTS: same_order(POINTS)},
    several=("hands", "multi_hand_landmarks", "hand_landmarks", "handLandmarks"),
    command="posetrack hand run --help",
    plain=_plain,
    flat={"hand_left_keypoints_2d": "left", "hand_right_keypoints_2d": "right"},
    parts={"left": slice(91, 112), "right": slice(112, 133)},
    ends=("wrist", "tip of the little finger"),
)
