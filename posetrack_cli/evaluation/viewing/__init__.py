"""Pictures of estimates on the frames they were made from."""
