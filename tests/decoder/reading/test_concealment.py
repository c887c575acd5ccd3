"""What is said of damage, and how often."""

from __future__ import annotations

from dataclasses import replace

import pytest

from decogs.decoder.reading.damage import Concealment, Damage, DamageWarning
from decogs.formats.errors import StreamError
from decogs.formats.stream.reasons import Reason

HERE = Damage(StreamError(Reason.BAD_PAYLOAD_CRC, "a packet's checksum", offset=70), range(3, 6), held=2)


def error(**fields: object) -> StreamError:
    found = StreamError(Reason.BAD_PAYLOAD_CRC, "a packet's checksum", offset=70)
    for name, value in fields.items():
        setattr(found, name, value)
    return found


def test_a_place_is_told_once_however_often_it_is_read() -> None:
    told: list[Damage] = []
    concealment = Concealment("x.dgs", strict=False, on_damage=told.append)
    for damage in (
        HERE,
        replace(HERE, error=error()),
        replace(HERE, frames=range(3, 7)),  # it costs one more than was known
        replace(HERE, error=error(offset=90)),
        replace(HERE, error=error(reason=Reason.TRUNCATED)),
        replace(HERE, frames=range(0), error=error(sound_of=3)),
        replace(HERE, frames=range(0), error=error(sound_of=4)),
        replace(HERE, frames=range(0), error=error(sound_of=4)),
    ):
        concealment.report(damage)
    assert len(told) == 6
    assert all(str(damage).startswith("x.dgs: ") and str(damage).count("x.dgs") == 1 for damage in told)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (HERE, "frames 3 to 5 show frame 2"),
        (replace(HERE, frames=range(3, 4)), "frame 3 shows frame 2"),
        (replace(HERE, onward=True), "frames from 3 on show frame 2 until the next keyframe"),
        (replace(HERE, frames=range(0)), "no frame is known to be lost by it"),
        (replace(HERE, frames=range(0), error=error(sound_of=4)), "the sound of frame 4 is lost, and no frame"),
    ],
)
def test_what_is_shown_instead_is_said(damage: Damage, said: str) -> None:
    assert str(damage).endswith(f"; {said}")


def test_only_damage_is_concealed_and_nothing_where_a_stream_is_read_strictly() -> None:
    foreign = StreamError(Reason.TOO_LARGE, "above the limit")
    assert Concealment("x", strict=False, on_damage=None).allows(HERE.error)
    assert not Concealment("x", strict=False, on_damage=None).allows(foreign)
    assert not Concealment("x", strict=True, on_damage=None).allows(HERE.error)


def test_nobody_who_listens_is_a_warning() -> None:
    with pytest.warns(DamageWarning, match="frames 3 to 5 show frame 2"):
        Concealment("x", strict=False, on_damage=None).report(HERE)
