"""Initialisation of a head's track: the ten points in space, from one or several calibrated cameras."""
