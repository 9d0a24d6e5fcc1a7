"""What scripts/bench measures, by subject; every part yields rows of one table."""
