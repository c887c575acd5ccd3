"""A stream opened and read: frames, damage, limits, a stream that still grows, and its facts."""
