"""What draws (`port`, implemented in `gl`), and the meshes that it draws. Knows no hands and no heads."""
