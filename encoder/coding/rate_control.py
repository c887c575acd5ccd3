"""Rate control: a scale of qualities, and a byte budget that later frames keep on average.

Chosen: one knob, the significance threshold; the rate-distortion lambdas follow it. After every frame, a model of a
single number moves it: a frame's content (its size at the settings' own threshold), estimated from past packets. The
model has no other input. A stream holds those sizes, so a resumed encode has the same bytes. The model does not know
the clip's length, so frames can be added. Rejected: two passes (twice the time, and none for a live rig); coding a
frame again until it fits (training is the cost); the threshold alone (a frame of workbench then takes at most 20 kB,
whatever the budget).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from decogs.formats.errors import UsageError
from decogs.formats.stream.container import PacketKind

from ..methods import require_sparse
from ..settings.checked import MOST_BYTES, MOST_LOSS
from ..settings.encode import EncodeSettings
from ..settings.frame import SignificanceSettings

NEUTRAL_QUALITY = 50.0
"""The preset as it is."""

BYTES_TOLERANCE = 0.05
"""Share of the budget by which a clip's mean may miss it without a warning."""

_QUALITIES_PER_OCTAVE = 16.0
_STEP_EXPONENT = 0.25
"""Lattice steps grow with this power of the threshold: bytes and loss of keyframes then change together with those of
later frames."""

_RESPONSE_EXPONENT = 0.5
"""Bytes fall with this power of the threshold: measured .41 to .65 (report/budgets.md). The control settles even if
they fall four times as steeply, or hardly at all."""
_BYTES_HORIZON_FRAMES = 12
"""Frames over which savings and overspends are balanced: fewer follow the budget closer, more are steadier."""
_ESTIMATE_KEPT = 0.5
"""Weight of the old estimate against the newest packet's: a frame's bytes are noisy."""
_TARGET_RANGE = (0.8, 2.0)
"""Bounds of a single frame's target, in budgets: the savings of a still scene are not spent on the first frame that
moves, and an overspend is paid back gently, because later frames must code changes that were reverted."""
_MIN_SHARE = 2.0**-8
"""Least target of a frame, in budgets, where the keyframe of its segment alone takes more than all of them."""
_MAX_OCTAVES = 8.0
"""The threshold stays between 1/256 (next to nothing is reverted) and 256 times the preset's."""
_OCTAVE_STEPS = 32
"""Steps of the threshold per octave: on this grid, the last bit of a logarithm, which differs by machine, is lost."""


def with_quality(settings: EncodeSettings, quality: float) -> EncodeSettings:
    """The same settings at a quality of 0 to 100; raises UsageError beyond.

    50 is the settings as they are. Every 16 points lower double the significance threshold and lambda of later frames,
    multiply the lattice's steps by 2^(1/4), and the keyframe's lambda by 2^(1/2).
    Settings that code every change (``paper``, ``3dgstream``) follow with the keyframe and the lattice only.
    """
    if not 0 <= quality <= 100:
        raise UsageError(f"`quality` {quality:g}: give a number from 0 (smallest) to 100 (most exact)")
    factor = 2.0 ** ((NEUTRAL_QUALITY - quality) / _QUALITIES_PER_OCTAVE)
    significance = scaled_significance(settings.frame.significance, factor)
    rd_lambda = _round_loss(settings.keyframe.rd_lambda * factor ** (2 * _STEP_EXPONENT))
    return replace(
        settings,
        keyframe=replace(settings.keyframe, rd_lambda=rd_lambda),
        lattice_scale=_round(settings.lattice_scale * factor**_STEP_EXPONENT),
        frame=replace(settings.frame, significance=significance),
    )


def with_lossless(settings: EncodeSettings) -> EncodeSettings:
    """The same settings with every change coded, however small, and exact to the lattice."""
    significance = replace(settings.frame.significance, threshold=0.0, rd_lambda=0.0, colour_rd_lambda=0.0)
    return replace(settings, frame=replace(settings.frame, significance=significance))


def with_budget(settings: EncodeSettings, bytes_per_frame: float) -> EncodeSettings:
    """The settings with a budget: mean bytes of the frames after the first.

    Raises UsageError for a number that is no budget, and for settings that code every change.
    """
    asked = f"`bytes_per_frame` {bytes_per_frame:g}"
    if not 1 <= bytes_per_frame <= MOST_BYTES:
        raise UsageError(f"{asked}: that is {bytes_per_frame:g} bytes a frame; give at least 1, at most {MOST_BYTES:g}")
    require_sparse(settings, asked, "codes every change")
    if not settings.frame.significance.threshold:
        raise UsageError(f"{asked}: these settings code every change; choose `settings` draft, standard or high")
    return replace(settings, frame_budget=bytes_per_frame)


def over_budget(sizes: Sequence[int], frame_budget: float) -> float:
    """By which share the mean of these packets, in bytes, is above the budget; 0 when it is not, or there are none."""
    return max(0.0, sum(sizes) / (len(sizes) * frame_budget) - 1) if sizes else 0.0


@dataclass(frozen=True)
class RateControl:
    """Multiplies the significance threshold so that later frames keep to a mean of ``budget`` bytes.

    It learns from the packets alone, which a stream holds, so that a resumed encode has the same bytes. Another one is
    made where a closed segment starts. ``segment``: frames from one keyframe to the next, or 0. Keyframes after the
    first count as frames. The other frames of their segment pay evenly for their bytes beyond the budget, so a clip of
    whole segments meets it. Rejected: saving up for them (their size is unknown; on workbench it doubles from one to
    the next).

    ``frames`` so far and the bytes ``spent`` on them; ``index``: frames since the last keyframe, whose size is ``key``;
    ``content``: log2 of a delta's size at the settings' own threshold, in budgets; ``octaves``: log2 of the factor.
    """

    budget: float
    segment: int
    frames: int = 0
    spent: int = 0
    index: int = 0
    key: int | None = None
    content: float | None = None
    octaves: float = 0.0

    @property
    def factor(self) -> float:
        """Of the significance threshold, for the next frame."""
        return float(2.0**self.octaves)

    def significance(self, settings: SignificanceSettings) -> SignificanceSettings:
        """The settings for the next frame: its threshold, and lambdas to match."""
        return scaled_significance(settings, self.factor)

    def after(self, kind: int, size: int) -> RateControl:
        """The control after a packet other than the first keyframe's: its PacketKind and its bytes on disk.

        Keyframes and frames without a change give no estimate of a delta's size.
        """
        # A first packet that is a keyframe begins a closed segment, which has its own control.
        index = 0 if not self.frames and kind == PacketKind.KEY else self.index + 1
        key, content = self.key, self.content
        if kind == PacketKind.KEY and self.segment:
            key = size
        elif kind == PacketKind.DELTA:
            estimate = math.log2(size / self.budget) + _RESPONSE_EXPONENT * self.octaves
            past = estimate if content is None else content
            content = _ESTIMATE_KEPT * past + (1 - _ESTIMATE_KEPT) * estimate
        now = replace(self, frames=self.frames + 1, spent=self.spent + size, index=index, key=key, content=content)
        return now if content is None else replace(now, octaves=now._octaves(content))

    def _octaves(self, content: float) -> float:
        octaves = (content - math.log2(self._target())) / _RESPONSE_EXPONENT
        return round(min(max(octaves, -_MAX_OCTAVES), _MAX_OCTAVES) * _OCTAVE_STEPS) / _OCTAVE_STEPS

    def _target(self) -> float:
        """What the next frame is to take, in budgets."""
        saved = self.budget * self.frames - self.spent
        share = self.budget
        if self.key is not None:
            payment = (self.key - self.budget) / max(1, self.segment - 1)
            share = max(share - payment, _MIN_SHARE * self.budget)
            saved += payment * (self.segment - 1 - self.index % self.segment)
        low, high = _TARGET_RANGE
        return min(max((share + saved / _BYTES_HORIZON_FRAMES) / self.budget, low * share / self.budget), high)


def scaled_significance(settings: SignificanceSettings, factor: float) -> SignificanceSettings:
    """The settings with threshold and lambdas multiplied by ``factor``."""
    return replace(
        settings,
        threshold=_round_loss(settings.threshold * factor),
        rd_lambda=_round_loss(settings.rd_lambda * factor),
        colour_rd_lambda=_round_loss(settings.colour_rd_lambda * factor),
    )


def _round(value: float) -> float:
    """To six digits: a power's last bit is not the same on every machine, and the stream's header has the value."""
    return float(f"{value:.6g}")


def _round_loss(value: float) -> float:
    """The same, within what settings take."""
    return min(_round(value), MOST_LOSS)
