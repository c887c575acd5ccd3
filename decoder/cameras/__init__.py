"""Cameras to render with: pose files, camera paths, moves, USD cameras, lenses and corrections."""
