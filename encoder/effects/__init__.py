from .names import FRAME_EFFECTS as FRAME_EFFECTS
from .building import leave_out as leave_out
from .frame_look import frame_effects as frame_effects
