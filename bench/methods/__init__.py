"""Ways to train that others are compared with: parts of a method left out. The encoder finds them by entry point."""
