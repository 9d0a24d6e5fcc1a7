"""How the head trackers do on people that nothing was tuned on."""
