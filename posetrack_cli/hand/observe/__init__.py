"""Windows around a prediction, and hand detection in whole images."""
