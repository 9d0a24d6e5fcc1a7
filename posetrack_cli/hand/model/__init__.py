"""What a hand is; nothing here knows an image."""
