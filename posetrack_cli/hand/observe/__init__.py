"""What a frame shows around a prediction, and hands in a whole image."""
