"""From a rig's footage to what training takes: pictures, compensation of camera drift, an imported keyframe."""
