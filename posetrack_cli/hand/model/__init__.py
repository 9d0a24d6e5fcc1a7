"""Models of a hand, independent of images."""
