"""What a camera that is recording has delivered so far: pictures in a folder, each a file of its own."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..cameras import Camera
from ..errors import RigError
from ..pictures.reading import Picture, picture_facts, read_picture

LACKING = "no picture of it came"
DAMAGED = "its picture is damaged"
OVERRUN = "the encoder was behind, and the queue full"
"""Why a camera has no picture of a frame."""


class Feed(Protocol):
    """One camera's pictures as they come, by their frames counted from 0. Frames are asked for in rising order."""

    @property
    def origin(self) -> str:
        """Where the first picture comes from, and what is known of why it does not, for messages."""
        ...

    @property
    def advice(self) -> str:
        """What to do where no picture comes at all."""
        ...

    def reached(self, frame: int) -> bool:
        """Whether this frame has come, or one after it."""
        ...

    def take(self, frame: int) -> Picture | None:
        """The picture of a frame; None while it is not there whole. Raises RigError for what cannot be encoded."""
        ...

    def holds(self, frame: int) -> bool:
        """Whether the picture of a frame has come, but is given out only when more has."""
        ...

    def is_over(self, frame: int) -> bool:
        """Whether the picture of a frame that is not there will not come any more."""
        ...

    def why(self, frame: int) -> str:
        """Why there is no picture of a frame."""
        ...

    def finish(self) -> bool:
        """Gives out what is held back until more comes; whether there may be anything still."""
        ...

    def close(self) -> None:
        """Ends it."""
        ...


@dataclass(frozen=True)
class FolderFeed:
    """A picture for each frame: ``before``, the frame's number plus ``first`` in ``digits``, and ``after``.

    Files on disk are the queue: nothing is read ahead of what is asked for.
    """

    camera: Camera
    before: str
    digits: int
    after: str
    first: int
    advice: str = "start the camera"

    @property
    def origin(self) -> str:
        """The first picture."""
        return str(self.file(0))

    def file(self, frame: int) -> Path:
        """The picture of a frame."""
        return Path(f"{self.before}{self.first + frame:0{self.digits}d}{self.after}")

    def reached(self, frame: int) -> bool:
        """Whether the frame's file is there."""
        return os.path.exists(self.file(frame))

    def take(self, frame: int) -> Picture | None:
        """The picture in the frame's file; None while that is not there or not whole."""
        file = self.file(frame)
        if not os.path.exists(file):
            return None
        try:
            facts = picture_facts(file)
            if (facts.width, facts.height) == (self.camera.width, self.camera.height):
                return read_picture(file)
        except RigError:
            return None
        raise of_another_size(str(file), self.camera, facts.width, facts.height)

    def holds(self, frame: int) -> bool:
        """False: a file holds one picture."""
        return False

    def is_over(self, frame: int) -> bool:
        """False: a file may come at any time."""
        return False

    def why(self, frame: int) -> str:
        """Damaged, or not there."""
        return DAMAGED if self.reached(frame) else LACKING

    def finish(self) -> bool:
        """False: nothing is held back."""
        return False

    def close(self) -> None:
        """Nothing to do."""


def of_another_size(origin: str, camera: Camera, width: int, height: int) -> RigError:
    """The error to raise for pictures that the calibration is not of."""
    return RigError(
        f"{origin}: {width} x {height} pixels, but camera {camera.name} is calibrated for {camera.width} x "
        f"{camera.height}; record in that size"
    )
