"""Training of the keyframe and of later frames."""
