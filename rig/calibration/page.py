"""A calibration as a page: the rig from above and from the side, a row for each camera, and what is not connected."""

from __future__ import annotations

from html import escape

from ..check.plan import document, listed, plan, thumbnail
from .footage import pictures_at
from .placed import MAX_ERROR, Calibration, Placed

_SURE, _DOUBTED = "#2e7d32", "#b26a00"
_HEADINGS = ("camera", "picture", "focal length", "lens", "error", "linked to")


def page_of(calibration: Calibration, title: str) -> str:
    """The page, HTML. Colours: green, or orange for cameras with doubts."""
    cameras = [one.camera for one in calibration.placed]
    colours = {camera.name: _DOUBTED if camera.name in calibration.doubts else _SURE for camera in cameras}
    links = {pair: count for pair, count in calibration.links.items() if set(pair) <= colours.keys()}
    shared = "times both saw the board" if "board" in calibration.way else "points that both see"
    unit = f"Unit: {calibration.length_unit}." if calibration.length_unit else "Unit: the mean distance of two cameras."
    every = len(cameras) + len(calibration.not_connected)
    return document(
        title,
        [
            f"<p>{len(cameras)} of {every} cameras placed: {escape(calibration.way)}. {unit}</p>",
            *listed("Not connected", [f"{name}: {why}" for name, why in calibration.not_connected.items()]),
            *listed("In doubt", [f"{name}: {doubt}" for name, doubt in calibration.doubts.items()]),
            f"<h2>From above</h2><p>Lines: {shared}, thicker for more. Grey: what cameras see.</p>",
            plan(cameras, colours, links, calibration.points),
            "<h2>From the side</h2>",
            plan(cameras, colours, links, calibration.points, from_side=True),
            "<h2>Cameras</h2>",
            '<div class="wide"><table><tr>' + "".join(f"<th>{heading}</th>" for heading in _HEADINGS) + "</tr>",
            *(_row(one, links) for one in calibration.placed),
            "</table></div>",
            f"<p>Error: of reprojection, root mean square, px; up to {MAX_ERROR:.1%} of the width is taken.</p>",
        ],
    )


def _row(one: Placed, links: dict[tuple[str, str], int]) -> str:
    camera = one.camera
    others = {
        name: count for pair, count in links.items() if camera.name in pair for name in pair if name != camera.name
    }
    by_count = sorted(others.items(), key=lambda other: -other[1])
    picture = next(pictures_at(one.footage, range(1)))
    return (
        f"<tr><td>{escape(camera.name)}</td><td>{thumbnail(picture)}</td>"
        f"<td class='n'>{camera.fx:.1f} px</td><td>{camera.distortion_model}</td><td class='n'>{one.error:.2f} px</td>"
        f"<td>{escape(', '.join(f'{name} ({count})' for name, count in by_count)) or 'none'}</td></tr>"
    )
