"""Entropy coding: groups of attributes and index sets as byte planes behind zstd."""
