"""What all heads share: ten feature points, poses, shapes, and what the points look like in images."""
