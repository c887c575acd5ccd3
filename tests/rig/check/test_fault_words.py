"""What is said of a camera, by what was measured of it."""

from __future__ import annotations

from typing import Any

import pytest

from decogs.rig.check.faults import GOOD, HARMFUL, USABLE, Findings, faults_of, verdict_on


def found(**measured: Any) -> Findings:
    return Findings("cam05", **({"sharpness": 1.0, "noise": 1.2, "usual_noise": 1.2, "late": 0.0} | measured))


@pytest.mark.parametrize(
    ("measured", "words", "verdict"),
    [
        ({}, [], GOOD),
        ({"lost": [3], "hung": [4, 5], "moving": True}, ["dead"], HARMFUL),
        ({"noise": 60.0, "matched": False, "moving": True}, ["noise"], HARMFUL),
        ({"noise": 60.0, "usual_noise": 50.0}, [], GOOD),  # of a rig in the dark
        ({"hung": [4, 5], "late": 3.0}, ["frozen"], HARMFUL),  # late by what it repeats
        ({"moving": True, "late": 3.0}, ["moving"], HARMFUL),
        ({"hung": [4, 5], "sharpness": 0.2}, ["blurred"], HARMFUL),  # whose pictures differ too little to tell
        ({"swapped": "cam06", "misplaced": True, "late": 3.0}, ["swapped"], HARMFUL),
        ({"misplaced": True, "turned": 2.0, "late": 3.0}, ["turned"], HARMFUL),
        ({"misplaced": True, "residual": 4.0}, ["misplaced"], HARMFUL),
        ({"misplaced": True, "turned": 2.0, "sharpness": 0.2}, ["blurred"], HARMFUL),
        ({"late": -0.5}, ["late"], HARMFUL),
        ({"late": 0.49}, [], GOOD),
        ({"dropped": [7], "unread": [8]}, ["damaged", "dropped"], USABLE),
        ({"noise": 3.6}, ["noisy"], USABLE),
        ({"noise": 1.9, "usual_noise": 0.3}, [], GOOD),  # too little to matter
        ({"stops": -0.8}, ["exposure"], USABLE),
    ],
)
def test_faults_by_what_is_measured(measured: dict[str, Any], words: list[str], verdict: str) -> None:
    faults = list(faults_of(found(**measured)))
    assert [fault.word for fault in faults] == words
    assert verdict_on(faults) == verdict


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([4], "in frame 4;"),
        ([4, 5, 6], "in frames 4 to 6;"),
        ([1, 2, 5, 8, 9], "in frames 1 to 2, 5, 8 to 9;"),
        ([1, 2, 5, 8, 9, 11, 20, 21], "in frames 1 to 2, 5, 8 to 9 and 2 more;"),
    ],
)
def test_frames_are_told_in_rows_of_which_three_are_named(frames: list[int], said: str) -> None:
    (fault,) = faults_of(found(lost=frames))
    assert said in str(fault)


@pytest.mark.parametrize(
    ("late", "said"), [(1.0, "1 frame late"), (-2.5, "2.5 frames early"), (0.5, "0.5 frames late")]
)
def test_by_how_much_it_is_late_is_said(late: float, said: str) -> None:
    (fault,) = faults_of(found(late=late))
    assert said in fault.looks
