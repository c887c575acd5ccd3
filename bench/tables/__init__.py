"""Figures of runs in tables: columns, and what a row has more than another, seed by seed."""
