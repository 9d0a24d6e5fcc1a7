"""The studies behind docs/benchmarks.md and the papers' figures, and how the shipped models are built."""
