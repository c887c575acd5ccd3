"""Changes in a frame: difference masks, selection of Gaussians, flashes."""
