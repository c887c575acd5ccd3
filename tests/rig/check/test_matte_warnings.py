"""What is said of mattes before work begins."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.formats.errors import RigError
from decogs.rig.check.mattes import check_mattes, lost_mattes
from decogs.rig.pictures.ingest import RigFrame

NAMES = ("cam00", "cam01")


def warnings(worn: tuple[float, ...], told: tuple[str, ...] = ()) -> list[str]:
    views = [SimpleNamespace(camera=SimpleNamespace(name=name), pinhole=None, recorded=None) for name in NAMES]
    ingest: Any = SimpleNamespace(views=views, matte_warnings=told, matte_origin=lambda name, index: f"{name}/{index}")
    said: list[str] = []
    frame = RigFrame(3, [], [], alpha=[np.eye(8, dtype=np.float32)] * 2, screen_coloured_shares=worn)
    check_mattes(ingest, frame, said.append)
    return said


@pytest.mark.parametrize("worn", [(), (0.0, 0.006), (0.006, 0.001)])
def test_hardly_any_of_the_screens_colour_is_no_warning(worn: tuple[float, ...]) -> None:
    assert warnings(worn) == []


def test_cloth_of_the_screens_colour_is_named_where_there_is_most() -> None:
    (warning,) = warnings((0.007, 0.02))
    assert warning.startswith("cam01/3: 2.0% of the subject has the screen's colour")


def test_what_the_mattes_themselves_warn_of_comes_first() -> None:
    assert warnings((0.02, 0.0), ("one", "two"))[:2] == ["one", "two"]


def test_of_every_second_frame_the_lost_mattes_are_named() -> None:
    def given(names: Any, start: int, stop: int, lose: Any, step: int = 1) -> Iterator[dict[str, Any]]:
        for index in range(start, stop, step):
            if index == 4:
                lose(index, "cam01", RigError("it is gone"))
            yield {"cam00": np.full((4, 4), index == 2, np.float32)}

    done: list[tuple[int, int]] = []
    mattes: Any = SimpleNamespace(given=given)
    lines = lost_mattes(mattes, NAMES, range(0, 7, 2), lambda *progress: done.append(progress))
    assert list(lines) == [
        "camera cam00 has no matte in frame 2, and is left out there: it is white all over; white is subject, "
        "black is empty",
        "camera cam01 has no matte in frame 4, and is left out there: it is gone",
    ]
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]
