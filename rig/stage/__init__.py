"""Plain stages: the backdrop as a layer of its own, and the hull of what stands in front of it."""
