"""What is asked of a rig: variants of the encoder as plain data, and the questions that sets of them answer."""
