"""Other ways to keep the same frames, so that a stream's size can be compared: written to disk, read again, measured.

``sequences``: what a rival is. ``float_arrays``: a file for each frame, as are the formats of
``decogs.formats.splat_files``. ``splat4d``: the rival codec of the PyPI package ``splats4d``. Readers here read what
the writers beside them wrote, nothing else: they are no import of strangers' files.
"""
