"""Where the image features of an average face lie in the head's frame.

They are ``face.MEAN_SHAPE`` but for two pairs: what a detector sees of a nostril is its opening, above the
sill, and of a brow its dark inner end, below the ridge that the statistics' landmark is on.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.head.face import BROWS, MEAN_SHAPE, NOSTRILS

FEATURES = MEAN_SHAPE.copy()
"""(K, 3) mm."""
FEATURES[NOSTRILS] = [[-8.5, -42.0, 26.0], [8.5, -42.0, 26.0]]
FEATURES[BROWS] = [[-15.5, 19.0, 19.0], [15.5, 19.0, 19.0]]
FEATURES.setflags(write=False)

NOSE_BASE = np.array([0.0, -37.0, 26.0])
"""mm: middle of the arc that the nose's wings and base form. It guides the fit; no shape has it."""
FITTED = np.vstack([FEATURES, NOSE_BASE])
"""(K + 1, 3) mm: what a mean face is fitted by."""
FITTED.setflags(write=False)

FEATURE_SD = np.array([3.5, 3.0, 3.0, 3.5, 6.0, 6.0, 5.0, 5.0, 6.0, 6.0])
"""(K,) mm: identity, expression and the detector's error of one coordinate together **[ours]**."""
FEATURE_SD.setflags(write=False)
