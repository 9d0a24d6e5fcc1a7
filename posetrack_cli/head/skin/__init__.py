"""The skin between the feature points, as one camera saw it over a whole recording **[ours]**."""
