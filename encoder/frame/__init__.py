"""One frame of a stream, in ten steps: `encode_frame` has them in order."""
