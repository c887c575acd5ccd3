"""What is wrong with a rig's mattes, said before work begins."""

from __future__ import annotations

import numpy as np

from decogs.decoder.subject import matte_checks
from decogs.formats.system.callbacks import OnWarning
from decogs.rig.pictures.ingest import Ingest, RigFrame

_MAX_WORN = 0.006
"""Share of a subject that has the screen's colour, in the view with most, from which it wears some."""


def check_mattes(ingest: Ingest, first: RigFrame, warn: OnWarning) -> str:
    """How the mattes of the ``first`` frame agree, in words; raises RigError where they cannot be what they should."""
    for text in ingest.matte_warnings:
        warn(text)
    places = [ingest.matte_origin(view.camera.name, first.index) for view in ingest.views]
    agree = matte_checks.check_mattes(places, [view.pinhole for view in ingest.views], first.alpha, warn)
    worn = int(np.argmax(first.worn)) if first.worn else 0
    if first.worn and first.worn[worn] > _MAX_WORN:
        warn(
            f"{places[worn]}: {first.worn[worn]:.1%} of the subject has the screen's colour, and may be keyed away "
            "elsewhere; dress it otherwise, or bring masks"
        )
    return agree
