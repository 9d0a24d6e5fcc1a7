"""What every tracker of recorded frames shares: the run over a recording, its record, its checkpoints."""
