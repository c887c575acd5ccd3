"""Layers of a finished stream: which Gaussians stand alone, and with which values (DESIGN.md)."""
