"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop."""
