"""Frames of a recording: file names that are numbered by frame, ranges, and rates as fractions."""
