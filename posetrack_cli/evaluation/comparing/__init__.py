"""Results beside each other: paired differences and their statistics."""
