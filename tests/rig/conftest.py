"""The tiny rigs, and textured pictures."""

from __future__ import annotations

import textured_pictures
import tiny_rigs

texture, with_noise = textured_pictures.texture, textured_pictures.with_noise
plane_views = textured_pictures.plane_views
tiny_rig, moving_rig, lens_rig = tiny_rigs.tiny_rig, tiny_rigs.moving_rig, tiny_rigs.lens_rig
shared_data = tiny_rigs.shared_data
