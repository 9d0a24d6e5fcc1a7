"""Landmarks from elsewhere: a face's points per frame that another program found, as noisy measurements.

``points`` says which of theirs are ours; ``file`` reads them, estimates their noise and refuses outliers;
``faces`` gives a tracker the faces of a frame. They begin a track, tell identity at its start, and bring
points back that have slid; they are never truth: a track that looks more like the face stays.
"""
