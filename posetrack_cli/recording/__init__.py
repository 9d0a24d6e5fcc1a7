"""Recordings: files and folders of images, messages or video, read as frames."""
