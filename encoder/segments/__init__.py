"""Closed segments: each starts from the first keyframe and depends on no other."""
