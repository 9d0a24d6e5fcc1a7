"""Dense facial points: lips, jaw, lids, irises and brows, and the actions that follow from them."""
