"""From figures to verdicts: gates, baselines, comparisons."""
