"""BD-rates of a contest: what every family takes more or less than one of them, the anchor, for the same quality."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..measures.bd_rate import FEWEST_POINTS, LEAST_OVERLAP, BDRate, CurvePoint, bd_rate
from ..runs.rivals import RatePoint
from .columns import markdown


class Sides(NamedTuple):
    """Which bytes for which quality: fields of RatePoint."""

    heading: str
    rate: str
    quality: str


SIDES = {
    "bd_rate": Sides("whole picture", "frame_bytes", "psnr"),
    "bd_rate_dynamic": Sides("dynamic", "frame_bytes", "psnr_dynamic"),
    "bd_rate_later": Sides("whole picture, frames after the first", "later_bytes", "psnr"),
    "bd_rate_later_dynamic": Sides("dynamic, frames after the first", "later_bytes", "psnr_dynamic"),
}
ABOUT = (
    "How many more bytes the same PSNR takes, on average over the PSNR that both reach (log rate over PSNR, "
    "interpolated by PCHIP); of whole files, and of what comes after the first frame. A curve takes "
    f"{FEWEST_POINTS} points, none of them beaten by another one in both; two curves, {LEAST_OVERLAP:.0%} of the "
    "narrower one's range in common. In place of a figure: what is lacking."
)


@dataclass(frozen=True)
class FamilyRates:
    """A family's BD-rates against the anchor, by keys of SIDES."""

    family: str
    rates: dict[str, BDRate]

    def document(self) -> dict[str, Any]:
        """For JSON: percent, and why there is none."""
        missing = {key: rate.why for key, rate in self.rates.items() if rate.percent is None}
        figures = {key: rate.percent for key, rate in self.rates.items()}
        row = {"rival": self.family, "description": self.family, "figures": figures}
        return row | {"missing": missing} if missing else row


def bd_rates(points: Sequence[RatePoint], anchor: str) -> list[FamilyRates]:
    """Of every family of the ``points`` but the ``anchor``, in their order; none where the anchor has no point."""
    families: dict[str, list[RatePoint]] = {}
    for point in points:
        families.setdefault(point.family, []).append(point)
    against = families.pop(anchor, None)
    if against is None:
        return []
    return [
        FamilyRates(family, {key: bd_rate(_curve(against, sides), _curve(mine, sides)) for key, sides in SIDES.items()})
        for family, mine in families.items()
    ]


def bd_rate_table(rows: Sequence[FamilyRates]) -> list[str]:
    """The rows as Markdown."""
    cells = [[row.family, *(_cell(rate) for rate in row.rates.values())] for row in rows]
    return markdown(["", *(sides.heading for sides in SIDES.values())], cells)


def _curve(points: Sequence[RatePoint], sides: Sides) -> list[CurvePoint]:
    pairs = ((getattr(point, sides.rate), getattr(point, sides.quality)) for point in points)
    return [CurvePoint(rate, quality) for rate, quality in pairs if quality is not None]


def _cell(rate: BDRate) -> str:
    return rate.why if rate.percent is None else f"{rate.percent:+.1f} %"
