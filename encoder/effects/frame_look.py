def frame_effects(current, previous, masks):
    return ("motion",)
