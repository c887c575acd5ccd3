"""A range of a rig's frames into one output: begun, resumed, interrupted or finished."""
