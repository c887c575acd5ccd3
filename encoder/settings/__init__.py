"""Settings: plain data that imports nothing of the encoder; every other room may read it."""
