"""Faces of many people in many expressions: a model that keeps who it is apart from what the face does."""
