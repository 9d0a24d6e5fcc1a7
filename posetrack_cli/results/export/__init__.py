"""Results in the formats of other tools: CSV, TUM, JSON, numpy."""
