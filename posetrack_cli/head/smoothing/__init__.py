"""A head smoothed over a whole recording: its pose by what points say, their places by their neighbours."""
