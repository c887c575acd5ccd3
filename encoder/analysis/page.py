"""The analysis as a page: the rig's plan, a row for each camera with its picture, what is wrong, and the effects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape

import numpy as np
from numpy.typing import NDArray

from decogs.rig.check.faults import GOOD, HARMFUL, USABLE
from decogs.rig.check.plan import document, listed, plan, thumbnail
from decogs.rig.check.rig_check import CameraCheck

from .analyse import Analysis

U8 = NDArray[np.uint8]

_COLOURS = {GOOD: "#2e7d32", USABLE: "#b26a00", HARMFUL: "#c62828"}
_HEADINGS = (
    "camera",
    "picture",
    "verdict",
    "seen by one",
    "by two",
    "nearest view",
    "matches",
    "off its lines",
    "turned",
    "late",
    "sharpness",
    "noise",
    "exposure",
    "connected to",
)


def page_of(analysis: Analysis) -> str:
    """The page, HTML."""
    check = analysis.check
    names = {camera.name: k for k, camera in enumerate(analysis.stats.cameras)}
    links = {
        (one.camera, other): count
        for one in check.cameras
        for other, count in one.connected.items()
        if other > one.camera
    }
    parts = [
        f"<p>{len(names)} cameras, {analysis.frame_count} frames</p>",
        *(f"<p>{escape(sentence)}</p>" for sentence in check.summary()),
        "<h2>Plan</h2><p>From above. Lines join cameras that see the same surfaces, thicker where they share more.</p>",
        plan(analysis.stats.cameras, {one.camera: _COLOURS[one.verdict] for one in check.cameras}, links),
        *listed("What is wrong", [str(fault) for camera in check.cameras for fault in camera.faults]),
        "<h2>Cameras</h2>",
        '<div class="wide"><table><tr>' + "".join(f"<th>{heading}</th>" for heading in _HEADINGS) + "</tr>",
        *(_row(camera, analysis.stats.pictures[names[camera.camera]][0]) for camera in check.cameras),
        "</table></div>",
        *listed("Effects that an encode compensates", list(_effects(analysis))),
    ]
    return document(analysis.path, parts)


def _row(check: CameraCheck, picture: U8) -> str:
    stops = None if math.isnan(check.stops) else f"{check.stops:+.1f} stops"
    others = sorted(check.connected.items(), key=lambda pair: -pair[1])
    figures = [*check.cells(), f"{check.sharpness:.0%}" if math.isfinite(check.sharpness) else "-"]
    figures += [f"{check.noise:.1f}", stops or "-"]
    words = f"<b style='color:{_COLOURS[check.verdict]}'>{check.verdict}</b><br>{escape(', '.join(check.trouble))}"
    cells = [f"<td>{escape(check.camera)}</td><td>{thumbnail(picture)}</td><td>{words}</td>"]
    cells += [f"<td class='n'>{figure.strip()}</td>" for figure in figures]
    cells.append(f"<td>{escape(', '.join(f'{name} ({count})' for name, count in others)) or 'none'}</td>")
    return "<tr>" + "".join(cells) + "</tr>"


def _effects(analysis: Analysis) -> Iterator[str]:
    for decision in analysis.decisions:
        if decision.detected:
            yield f"{decision.effect}, {', '.join(decision.cameras)}: {decision.reason}"
