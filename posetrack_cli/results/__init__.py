"""What a run produced: estimates and run record, written to and read from MCAP."""
