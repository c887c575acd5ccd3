"""``crop``: what lies in a region, over the whole take."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.state import Rows, State, all_rows, part_of, same_scene
from decogs.formats.cli.command_line import Parser, number
from decogs.formats.errors import UsageError
from decogs.formats.splats import logit, sigmoid

from ..regions import REGION_HELP, Region, region_of
from ..scene import positions
from ..segments import rows_among, with_choices
from ..take import Frame, Take
from .base import Opener, Operation

_LEAST_OPACITY = 1 / 1024
"""Less is drawn nowhere: a pixel of 8 bits does not show it."""


@dataclass(frozen=True)
class Crop(Operation):
    """Keeps the Gaussians whose centres lie in ``region`` in any frame of a segment; with ``outside`` the others.

    ``fade``: world units over which opacity falls to nothing beyond the border, frame by frame. Without, what stays
    keeps its bits in every frame.
    """

    region: Region
    outside: bool = False
    fade: float = 0.0
    name = "crop"
    summary = "keep what lies in a box, sphere or polygon, over the whole take"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames of fewer Gaussians. Raises UsageError, once they are read, where none is left in any."""
        if not (np.isfinite(self.fade) and self.fade >= 0):
            raise UsageError(f"crop: a fade of {self.fade:g} is not possible; give world units, above 0")
        header = take.header
        chosen = with_choices(take, lambda state: [self._depth(header, state) >= -self.fade])
        seen: list[tuple[int, int]] = []

        def read(start: int, stop: int) -> Iterator[Frame]:
            before: Frame | None = None
            after: State | None = None
            count = 0
            for frame, (ids,) in chosen(start, stop):
                if before is None or after is None or frame.is_key or not same_scene(before.state, frame.state):
                    after = self._cropped(header, frame.state, ids)
                before, count = frame, count + len(after)
                if len(seen) < 1:
                    seen.append((len(after), len(frame.state)))
                yield frame.of(after)
            if not count and stop - start == take.frame_count:
                raise UsageError(f"crop: {_nothing_left(header, take)}")

        kept = replace(take, read=read)
        return kept.with_note(lambda: f"crop: {seen[0][0]} of {seen[0][1]} Gaussians stay in the first frame")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The region, and what of it."""
        parser.add_argument("region", nargs="+", metavar="REGION", help=REGION_HELP)
        parser.add_argument("--outside", action="store_true", help="keep what lies outside instead")
        parser.add_argument(
            "--fade", type=number, default=0.0, metavar="D", help="fade over D world units beyond the border"
        )

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Crop:
        """Of the region in words."""
        return cls(region_of(options.region), options.outside, options.fade)

    def _depth(self, header: StreamHeader, state: State) -> NDArray[np.float64]:
        depth = self.region.depth(positions(header, state))
        return -depth if self.outside else depth

    def _cropped(self, header: StreamHeader, state: State, ids: Rows) -> State:
        stays = rows_among(state, ids)
        state = state if stays.all() else part_of(state, stays)
        if not self.fade:
            return state
        beyond = np.clip(-self._depth(header, state) / self.fade, 0, 1)
        fading = np.flatnonzero(beyond > 0)
        if not len(fading):
            return state
        attributes, step = all_rows(state), header.lattice.opacity_logits
        share = 1 - beyond[fading] ** 2 * (3 - 2 * beyond[fading])
        before = attributes.opacity_logits[fading]
        faded = logit(np.maximum(sigmoid(before * step) * share, _LEAST_OPACITY))
        opacity_logits = attributes.opacity_logits.copy()
        opacity_logits[fading] = np.minimum(before, np.rint(faded / step)).astype(np.int32)
        attributes = replace(attributes, opacity_logits=opacity_logits)
        return new_state(attributes, state.frame, ids=state.ids, next_id=state.next_id)


def _nothing_left(header: StreamHeader, take: Take) -> str:
    scene = positions(header, next(take.read(0, 1)).state)
    if not len(scene):
        return "nothing is there to be kept"
    low, high = (",".join(f"{v:.3g}" for v in corner) for corner in np.percentile(scene, [2, 98], axis=0))
    return f"nothing would be left; 96 % of the first frame lies between {low} and {high}"
