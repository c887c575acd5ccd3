"""What to expect of a rig before it is encoded: poses, delays, light, noise, faults of single cameras."""
