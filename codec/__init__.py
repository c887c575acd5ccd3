"""The normative integer maths of a .dgs stream, both directions: lattice, prediction, entropy coding, reconstruction."""
