"""What a result is measured against: found, read and checked."""
