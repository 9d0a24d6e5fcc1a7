"""Detection of faces and their ten points in one grey image."""
