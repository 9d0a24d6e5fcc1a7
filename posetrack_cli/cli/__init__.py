"""Command line. Heavy imports stay inside the commands, so that help and completion are fast."""
