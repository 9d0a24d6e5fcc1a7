"""The adjustment's inner loops, compiled: cost, Jacobian, Schur complement, bounded descent."""
