"""The base of every part but the first: the first keyframe and the settings, read from an earlier part."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import lamps_of
from decogs.codec.reconstruct import reconstruct
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.regular_files import open_regular
from decogs.formats.stream.container import FRAME_KINDS, IndexEntry, Packet, PacketKind, PacketReader
from decogs.formats.stream.reasons import Reason

from ..analysis import AUTO, EFFECT_NAMES, EffectChoice, disable, with_effects
from ..input.imported_keyframe import KeyframeSource
from ..output.resume import Interrupted, difference_of, difference_of_headers
from ..settings.effects import CorrectionSettings
from ..settings.encode import EncodeSettings
from ..settings.reading import read_settings
from .manifest import Part, read_part, without_part


@dataclass(frozen=True)
class FirstKeyframe(Interrupted):
    """The first keyframe of a take as a part has it, with the header of the whole stream."""

    def _refuse(self, problem: str, remedy: str = "give every part the same options") -> NoReturn:
        raise UsageError(f"`keyframe` {self.path}: it {problem}; {remedy}")


@dataclass(frozen=True)
class Base:
    """A part that others of the same take start from: its manifest, and the first keyframe in it."""

    part: Part
    keyframe: FirstKeyframe

    @property
    def packet(self) -> Packet:
        """The first keyframe's packet, as it was written."""
        return next(self.keyframe.packets())

    @property
    def source(self) -> KeyframeSource:
        """The first keyframe's Gaussians; raises StreamError for a damaged one."""
        header = self.keyframe.header
        return KeyframeSource(self.keyframe.path, header, reconstruct(None, self.packet, header))

    def difference(self, other: Base) -> str:
        """What makes two parts belong to different encodes: a few words; empty if nothing does."""
        if problem := self.part.difference(other.part):
            return problem
        mine, others = self.keyframe, other.keyframe
        if problem := difference_of(mine.header.settings, others.header.settings, "the other one has"):
            return f"it {problem}"
        if self.packet.payload != other.packet.payload:
            return "it starts from another first keyframe"
        problem = difference_of_headers(mine.header_payload, others.header_payload, "the other one has")
        return problem and f"it {problem}"

    def check(self, part: Part) -> None:
        """Raises UsageError unless ``part`` is of the same take, from the same input, made with the same releases."""
        if problem := self.part.difference(part):
            self._refuse(problem)

    def settings(self, asked: EncodeSettings, effects: EffectChoice | None) -> EncodeSettings:
        """The settings of the take; raises UsageError unless they are those that were ``asked`` for.

        What the effects change was decided with the keyframe, from the whole take.
        """
        try:
            own = read_settings(self.keyframe.header.settings)
        except (TypeError, ValueError, UsageError):
            self._refuse("its settings cannot be read")
        expected = asked if effects is None else _without_effects(asked)
        actual = own if effects is None else _without_effects(own)
        problem = difference_of(_later(actual).as_document(), _later(expected).as_document())
        if not problem and effects is not None and not _same_choice(own, asked, effects):
            problem = f"was begun with other effects than `effects` {effects}"
        if problem:
            self._refuse(f"it {problem}")
        lamps = lamps_of(self.keyframe.header.camera_colours)
        return replace(own, corrections=replace(own.corrections, lamps=lamps))

    def _refuse(self, problem: str) -> NoReturn:
        raise UsageError(f"`keyframe` {self.keyframe.path}: {problem}; give every part the same input and options")


def read_base(path: Path) -> Base | None:
    """The base in the file ``path``; None for a stream that is no part.

    Raises UsageError for one that is not there or damaged.
    """
    try:
        header, packet = _header_and_keyframe(path)
    except OSError as error:
        raise UsageError(f"`keyframe` {path}: {error.strerror}; give a part of this take") from error
    except StreamError as error:
        raise UsageError(f"`keyframe` {path}: it is damaged ({error}); encode that part again") from error
    part = read_part(header)
    if part is None:
        return None
    header = without_part(header)
    entry = IndexEntry(packet.offset, packet.frame, packet.kind)
    return Base(part, FirstKeyframe(path, header, header.to_bytes(), (entry,), packet.offset + packet.size, ended=True))


def _header_and_keyframe(path: Path) -> tuple[StreamHeader, Packet]:
    header = None
    with open_regular(path) as file:
        reader = PacketReader(file)
        while (packet := reader.next()) is not None:
            if packet.kind == PacketKind.HEADER:
                header = StreamHeader.from_bytes(packet.payload)
            elif packet.kind == PacketKind.KEY and packet.frame == 0 and header is not None:
                return header, packet
            elif packet.kind in FRAME_KINDS:
                break
    raise StreamError(Reason.MISSING_KEY, "the first keyframe is missing")


def _later(settings: EncodeSettings) -> EncodeSettings:
    """The settings of frames after the keyframe; what made that does not matter any more."""
    usual = EncodeSettings()
    return replace(settings, keyframe=usual.keyframe, lattice_scale=usual.lattice_scale)


def _without_effects(settings: EncodeSettings) -> EncodeSettings:
    """The settings as if no effect had been chosen or detected."""
    plain = disable(settings, EFFECT_NAMES)
    return replace(plain, effects=(), detect_per_frame=False, corrections=CorrectionSettings())


def _same_choice(settings: EncodeSettings, asked: EncodeSettings, effects: EffectChoice) -> bool:
    """Whether the choice, as far as it says by itself what is enabled, is that of these ``settings``."""
    if settings.detect_per_frame != (effects.base == AUTO):
        return False
    try:
        fixed = with_effects(asked, effects, (), _undecided)
    except LookupError:
        return True
    return fixed.effects == settings.effects


def _undecided() -> NoReturn:
    raise LookupError("the choice depends on the rig")
