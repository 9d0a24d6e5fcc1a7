"""The papers' experiments, redone: run by scripts/reproduce."""
