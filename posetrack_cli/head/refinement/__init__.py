"""From the particle filter's estimate to the pose, deformation and points that the patches agree on best."""
