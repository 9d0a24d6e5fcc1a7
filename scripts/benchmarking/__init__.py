"""Parts of scripts/bench; each yields rows of one table."""
