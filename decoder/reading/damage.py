"""What is done about damage in a stream: it is concealed and reported, or an error when the stream is read strictly."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from decogs.formats.errors import StreamError
from decogs.formats.stream.survey import check_damage_count, is_damage


class DamageWarning(UserWarning):
    """Part of a stream is damaged and was concealed."""


@dataclass(frozen=True)
class Damage:
    """A damaged place of a stream: what is wrong, and what a reader that goes on shows instead.

    ``frames``: those that cannot be reconstructed, up to the next keyframe; none when only an accelerator or a packet
    for people is hit. They show the frame ``held``. ``onward``: so do those after them, up to a keyframe that had not
    come yet when this was reported; only in a stream that is followed. ``error`` names packet, offset and reason.
    """

    error: StreamError
    frames: range = range(0)
    held: int | None = None
    onward: bool = False

    def __str__(self) -> str:
        if not self.frames and self.error.sound_of is not None:
            return f"{self.error}; the sound of frame {self.error.sound_of} is lost, and no frame"
        if not self.frames:
            return f"{self.error}; no frame is known to be lost by it"
        first, last = self.frames[0], self.frames[-1]
        if self.onward:
            return f"{self.error}; frames from {first} on show frame {self.held} until the next keyframe"
        lost = f"frame {first} shows" if first == last else f"frames {first} to {last} show"
        return f"{self.error}; {lost} frame {self.held}"


OnDamage = Callable[[Damage], None]


class Concealment:
    """What may be concealed in a stream, and who is informed."""

    def __init__(self, name: Path | str, *, strict: bool, on_damage: OnDamage | None) -> None:
        """``name``: the stream's, for messages. Without ``on_damage``, a DamageWarning is issued."""
        self._name, self.strict = name, strict
        self._on_damage = _warn if on_damage is None else on_damage
        self._reported: set[tuple[int | None, str, range, int | None]] = set()

    def allows(self, error: StreamError) -> bool:
        """Whether to go on in spite of what is wrong."""
        return not self.strict and is_damage(error)

    def report(self, damage: Damage) -> None:
        """Each damaged place is reported once, however often it is read."""
        _name(damage.error, self._name)
        event = damage.error.offset, damage.error.reason, damage.frames, damage.error.sound_of
        if event not in self._reported:
            self._reported.add(event)
            check_damage_count(len(self._reported), damage.error)
            self._on_damage(damage)


@contextmanager
def errors_name(path: Path | str) -> Iterator[None]:
    """Puts the file's name before what the container and the codec, which know bytes only, have to say."""
    try:
        yield
    except StreamError as error:
        _name(error, path)
        raise


def _name(error: StreamError, path: Path | str) -> None:
    if not str(error).startswith(f"{path}: "):
        error.args = (f"{path}: {error}",)


def _warn(damage: Damage) -> None:
    warnings.warn(str(damage), DamageWarning, stacklevel=4)
