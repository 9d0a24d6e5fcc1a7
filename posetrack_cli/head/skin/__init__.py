"""Skin texture between the feature points, observed by one camera over a whole recording **[ours]**."""
