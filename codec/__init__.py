"""The normative integer maths of a .dgs stream, both ways: lattice, prediction, entropy coding, reconstruction."""
