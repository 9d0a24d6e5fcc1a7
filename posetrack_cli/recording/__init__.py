"""What a run reads: frames and cameras, from folders and MCAP files."""
