"""A take as one file of intent: everything that is delivered from one command, made again where something changed."""
