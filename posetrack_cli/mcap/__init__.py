"""The file format MCAP: records, streams, salvage of damaged files, a sink, decoding. Knows no recordings."""
