"""The field's baseline: each frame's hand by particle swarm optimisation (Oikonomidis et al., BMVC 2011)."""
