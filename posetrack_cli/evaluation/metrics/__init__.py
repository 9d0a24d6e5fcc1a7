"""What is measured of a result, and what it is called."""
