"""Frames for other programs: files of Gaussians, or one USD file."""
