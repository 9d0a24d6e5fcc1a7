"""The hands that are shipped, learned from people: run by scripts/build hand-model."""
