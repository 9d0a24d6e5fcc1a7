"""What the hand tracker reaches: accuracy, intervals, recovery and speed, per configuration."""
