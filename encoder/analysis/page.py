"""The analysis as a page: the rig's plan, a row for each camera with its picture, what is wrong, and the effects.

One file without scripts and without anything loaded from elsewhere.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre

from .analyse import Analysis
from .faults import GOOD, HARMFUL, USABLE
from .rig_check import CameraCheck

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_COLOURS = {GOOD: "#2e7d32", USABLE: "#b26a00", HARMFUL: "#c62828"}
_PLAN_SIZE, _MARGIN = 560, 60
_WEDGE_PIXELS, _WEDGE_ANGLE = 26.0, math.radians(18)
_THUMBNAIL_WIDTH = 200
_MOST_MATCHES_STROKE = 5.0
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
_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#222;background:#fff}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.3em .6em;border-bottom:1px solid #ddd}"
    "td,th{text-align:left;vertical-align:top}td.n{text-align:right;white-space:nowrap}.wide{overflow-x:auto}svg{max-width:100%;height:auto}"
    "svg text{font-size:12px}ul{padding-left:1.2em}"
)


def page_of(analysis: Analysis) -> str:
    """The page, HTML."""
    check = analysis.check
    names = {camera.name: k for k, camera in enumerate(analysis.stats.cameras)}
    parts = [
        "<!doctype html>",
        f'<html lang="en"><meta charset="utf-8"><title>{escape(analysis.path)}</title><style>{_STYLE}</style>',
        f"<h1>{escape(analysis.path)}</h1>",
        f"<p>{len(names)} cameras, {analysis.frame_count} frames</p>",
        *(f"<p>{escape(sentence)}</p>" for sentence in check.summary()),
        "<h2>Plan</h2><p>From above. Lines join cameras that see the same surfaces, thicker where they share more.</p>",
        plan(analysis.stats.cameras, check.cameras),
        *_list("What is wrong", [str(fault) for camera in check.cameras for fault in camera.faults]),
        "<h2>Cameras</h2>",
        '<div class="wide"><table><tr>' + "".join(f"<th>{heading}</th>" for heading in _HEADINGS) + "</tr>",
        *(_row(camera, analysis.stats.pictures[names[camera.camera]][0]) for camera in check.cameras),
        "</table></div>",
        *_list("Effects that an encode compensates", list(_effects(analysis))),
    ]
    return "\n".join(parts) + "\n"


def plan(cameras: Sequence[Camera], checks: Sequence[CameraCheck]) -> str:
    """The cameras from above, SVG: where they stand, where they look, and which are connected."""
    places, ways = _from_above(cameras)
    at = dict(zip((camera.name for camera in cameras), places, strict=True))
    most = max([count for check in checks for count in check.connected.values()], default=1)
    lines, marks = [], []
    for check, way in zip(checks, ways, strict=True):
        here = at[check.camera]
        for other, count in check.connected.items():
            if other > check.camera:
                width = max(0.5, _MOST_MATCHES_STROKE * count / most)
                ends = " ".join(
                    f"{k}{n}='{v:.1f}'" for n, p in ((1, here), (2, at[other])) for k, v in zip("xy", p, strict=True)
                )
                lines.append(f"<line {ends} stroke='#9ab' stroke-width='{width:.1f}'/>")
        sides = [here + _WEDGE_PIXELS * _rotated(way, sign * _WEDGE_ANGLE) for sign in (-1, 1)]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in (here, *sides))
        x, y = here - 14 * way
        marks.append(
            f"<polygon points='{corners}' fill='{_COLOURS[check.verdict]}' opacity='.85'/>"
            f"<text x='{x:.1f}' y='{y + 4:.1f}' text-anchor='middle'>{escape(check.camera)}</text>"
        )
    size = f"viewBox='0 0 {_PLAN_SIZE} {_PLAN_SIZE}' width='{_PLAN_SIZE}'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' role='img' {size}>" + "".join(lines + marks) + "</svg>"


def _from_above(cameras: Sequence[Camera]) -> tuple[F64, F64]:
    """Where the cameras stand and look in the plan, pixels (N, 2) and unit vectors (N, 2); up is what most hold up."""
    centres = np.array([camera_centre(camera) for camera in cameras])
    rotations = np.array([camera.world_to_camera[:3, :3] for camera in cameras])
    up = -rotations[:, 1].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    across = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.8 else [0, 1.0, 0])
    axes = np.stack([across / np.linalg.norm(across), np.cross(up, across / np.linalg.norm(across))])
    places, ways = (centres - centres.mean(axis=0)) @ axes.T, rotations[:, 2] @ axes.T
    reach = max(float(np.abs(places).max()), 1e-9)
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
    return _PLAN_SIZE / 2 + places * ((_PLAN_SIZE / 2 - _MARGIN) / reach), ways


def _rotated(way: F64, angle: float) -> F64:
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1]])


def _row(check: CameraCheck, picture: U8) -> str:
    stops = None if math.isnan(check.stops) else f"{check.stops:+.1f} stops"
    others = sorted(check.connected.items(), key=lambda pair: -pair[1])
    figures = [*check.cells(), f"{check.sharpness:.0%}" if math.isfinite(check.sharpness) else "-"]
    figures += [f"{check.noise:.1f}", stops or "-"]
    words = f"<b style='color:{_COLOURS[check.verdict]}'>{check.verdict}</b><br>{escape(', '.join(check.trouble))}"
    cells = [f"<td>{escape(check.camera)}</td><td>{_thumbnail(picture)}</td><td>{words}</td>"]
    cells += [f"<td class='n'>{figure.strip()}</td>" for figure in figures]
    cells.append(f"<td>{escape(', '.join(f'{name} ({count})' for name, count in others)) or 'none'}</td>")
    return "<tr>" + "".join(cells) + "</tr>"


def _thumbnail(picture: U8) -> str:
    """A picture (H, W, 3) in the page itself."""
    height = max(1, round(picture.shape[0] * _THUMBNAIL_WIDTH / picture.shape[1]))
    small = cv2.resize(picture, (_THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", small[..., ::-1])[1].tobytes()).decode()
    return f"<img alt='' width='{_THUMBNAIL_WIDTH}' height='{height}' src='data:image/jpeg;base64,{data}'>"


def _list(heading: str, items: Sequence[str]) -> Iterator[str]:
    if items:
        yield f"<h2>{heading}</h2><ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def _effects(analysis: Analysis) -> Iterator[str]:
    for decision in analysis.decisions:
        if decision.detected:
            yield f"{decision.effect}, {', '.join(decision.cameras)}: {decision.reason}"
