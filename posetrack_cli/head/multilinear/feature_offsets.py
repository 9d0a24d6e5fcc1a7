"""How far the image features of a face lie from the landmarks of its statistics **[ours]**.

A tracker follows what a camera sees: the outer end of the lids' shadow, a nostril's dark opening, the brow's
dark inner end. The statistics' landmarks are vertices of a mesh. The figures are what stereo tracking measured
in two recordings with known vertices, averaged and made symmetric; of the brows, whose vertices are others there,
against the mean face. A model that is built from results of tracking needs none of them.
"""

from __future__ import annotations

import numpy as np

FEATURE_OFFSETS = np.array(
    [
        [-2.1, 1.8, 2.2],
        [-2.0, 1.7, 1.5],
        [2.0, 1.7, 1.5],
        [2.1, 1.8, 2.2],
        [-1.1, 1.2, 1.2],
        [1.1, 1.2, 1.2],
        [-1.5, 5.3, 11.0],
        [1.5, 5.3, 11.0],
        [-6.1, -10.3, 7.0],
        [6.1, -10.3, 7.0],
    ]
)
"""(K, 3) mm in the head's frame."""
FEATURE_OFFSETS.setflags(write=False)
