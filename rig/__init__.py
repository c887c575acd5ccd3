"""A rig made ready for encoding: cameras placed and in step, checked, and their pictures as training takes them."""
