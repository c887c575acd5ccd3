"""What is wrong with a rig's mattes, said before work begins."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from decogs.decoder.subject import matte_checks
from decogs.formats.errors import RigError
from decogs.formats.frames.ranges import frames_text
from decogs.formats.system.callbacks import OnProgress, OnWarning
from decogs.rig.mattes import Mattes
from decogs.rig.pictures.ingest import Ingest, RigFrame

_MAX_SCREEN_COLOURED_SHARE = 0.006
"""Share of a subject that has the screen's colour, in the view with most, from which it wears some."""
_NAMED_ROWS = 3
"""Rows of frames that are named; of more it is said how many there are."""


def check_mattes(ingest: Ingest, first: RigFrame, warn: OnWarning) -> str:
    """How the mattes of the ``first`` frame agree, in words; raises RigError where they cannot be what they should."""
    for text in ingest.matte_warnings:
        warn(text)
    places = [ingest.matte_origin(view.camera.name, first.index) for view in ingest.views]
    agree = matte_checks.check_mattes(
        places, [view.pinhole for view in ingest.views], first.alpha, [view.recorded for view in ingest.views], warn
    )
    shares = first.screen_coloured_shares
    worst = int(np.argmax(shares)) if shares else 0
    if shares and shares[worst] > _MAX_SCREEN_COLOURED_SHARE:
        warn(
            f"{places[worst]}: {shares[worst]:.1%} of the subject has the screen's colour, and may be keyed away "
            "elsewhere; dress it otherwise, or bring masks"
        )
    return agree


def lost_mattes(mattes: Mattes, names: Collection[str], frames: range, on_frame: OnProgress) -> Iterator[str]:
    """A line for every camera with ``frames`` whose matte cannot be had: an encode leaves the view out of those."""
    lost: dict[str, dict[int, str]] = {}

    def lose(index: int, name: str, error: RigError) -> None:
        lost.setdefault(name, {})[index] = str(error)

    read = mattes.given(names, frames.start, frames.stop, lose, step=frames.step)
    for done, (index, given) in enumerate(zip(frames, read, strict=True), 1):
        for name, matte in given.items():
            if index not in lost.get(name, ()) and matte_checks.is_white(matte):
                lose(index, name, RigError("it is white all over; white is subject, black is empty"))
        on_frame(done, len(frames))
    for name, frames_lost in lost.items():
        where = frames_text(list(frames_lost), most=_NAMED_ROWS)
        yield f"camera {name} has no matte in {where}, and is left out there: {next(iter(frames_lost.values()))}"
