"""Geometry of scenes: rotations, similarities, spherical harmonics, directions and units of length."""
