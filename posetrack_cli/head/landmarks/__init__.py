"""Face landmarks from other programs, used as noisy measurements.

They initialise a track and restore points that slid off their features; a track that matches the templates
better is kept.
"""
