"""From files to arrays: the tracks of a result and of its truth, frame by frame."""
