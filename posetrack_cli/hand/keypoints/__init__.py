"""Keypoints from other programs: 21 points per frame, used as further starts and evidence.

``file`` reads them (formats in ``recording.keypoints``), ``targets`` converts them to joint targets in camera
axes, ``hands`` fits hands to these and weighs them in tracking. They are never taken as truth: every pose is
scored against the depth image.
"""
