"""Units of length, as calibrations name them, in metres."""

from __future__ import annotations

import re

_METRES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("dm", "decimetre", "decimetres", "decimeter", "decimeters"), 0.1),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 0.001),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}


def metres_of(unit: str) -> float | None:
    """The metres of a unit that a text begins with, such as "centimetre" or "metre (square 5.4 cm)".

    None for any other text: "scene units (probably millimetre)" says that nobody knows.
    """
    match = re.match(r"\s*([a-z]+)(?=\s*$|\s*[(,;])", unit[:100], re.IGNORECASE)
    return None if match is None else _METRES.get(match[1].lower())
