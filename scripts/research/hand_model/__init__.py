"""Build the shipped hand model from people's hands (scripts/build hand-model)."""
