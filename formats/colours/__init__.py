"""Colours: the sRGB curve, ICC profiles, primaries, and from YCbCr to RGB."""
