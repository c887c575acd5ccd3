"""Files of Gaussians, one a frame, packed as a stream."""
