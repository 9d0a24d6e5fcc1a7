"""A hand's size and proportions from a recording of it: bundle adjustment of its shape and its poses."""
