"""From a rig's footage to what training takes: pictures, faults of single cameras, an imported keyframe."""
