"""A rig as planar pictures of pinhole cameras, with their mattes, noise and dropouts."""
