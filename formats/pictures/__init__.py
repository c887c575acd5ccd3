"""Single pictures: what a file says of its pixels, and the pixels."""
