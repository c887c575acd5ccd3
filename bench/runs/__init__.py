"""Variants and rivals over rigs: encoded, measured, kept as one JSON each."""
