"""Units of length in the words of calibrations."""

from __future__ import annotations

import pytest

from decogs.formats.geometry.length_units import metres_of


@pytest.mark.parametrize(
    ("said", "metres"),
    [
        ("metre", 1),
        ("metre (charuco square 5.4 cm)", 1),
        (" Centimetres, as the studio has them", 0.01),
        ("mm", 0.001),
        ("feet", 0.3048),
        ("scene units of the calibration (probably millimetre)", None),
        ("metres or feet", None),
        ("world units of the rig's calibration", None),
        ("0.01 m", None),
        ("", None),
        ("m" * 100_000, None),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_unit_counts_where_the_text_begins_with_it(said: str, metres: float | None) -> None:
    assert metres_of(said) == metres
