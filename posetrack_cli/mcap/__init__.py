"""Reading and writing MCAP files."""
