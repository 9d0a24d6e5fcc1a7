"""The studies behind docs/accuracy.md and the papers' figures, and how the shipped models are built."""
