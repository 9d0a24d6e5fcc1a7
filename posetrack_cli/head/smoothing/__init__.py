"""Smoothing of a head over a whole recording: poses by refitting, points by local regression."""
