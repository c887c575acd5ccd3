"""The Gaussians of a first frame: first points, training on the lattice, what views cannot show; or imported ones."""
