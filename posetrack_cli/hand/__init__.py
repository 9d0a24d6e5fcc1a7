"""The hand: kinematics, mesh, likelihood, tracker, and synthetic recordings of it."""
