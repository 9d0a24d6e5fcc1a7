"""From arrays to figures: metrics of frames, of recordings, of many recordings."""
