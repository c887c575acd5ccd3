"""What changed in a frame: masks, the Gaussians selected for them, flashes."""
