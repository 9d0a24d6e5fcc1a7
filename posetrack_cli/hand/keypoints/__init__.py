"""Keypoints from elsewhere: 21 points per frame that another program found, as further starts and evidence.

``file`` reads them (``recording.keypoints`` knows the layouts); ``places`` names the points and finds where
in the camera's axes they are, ``told`` makes poses of them and says what they are worth to a tracker. They
are never truth: a pose that they lead to costs what the image says.
"""
