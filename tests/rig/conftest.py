"""The encoder tests' tiny rig, and textured pictures."""

from __future__ import annotations

import textured_pictures
from encoder_fixtures import encoder_conftest

texture, with_noise = textured_pictures.texture, textured_pictures.with_noise
plane_views = textured_pictures.plane_views
tiny_rig, moving_rig, lens_rig = encoder_conftest.tiny_rig, encoder_conftest.moving_rig, encoder_conftest.lens_rig
encode, shared_data = encoder_conftest.encode, encoder_conftest.shared_data
