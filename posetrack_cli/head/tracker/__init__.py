"""The head tracker, and what it keeps of the head and of the face between frames."""
