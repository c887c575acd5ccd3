"""A rig drawn for a page: cameras and where they look, what links them, and what they see; and the page around it.

One file without scripts and without anything loaded from elsewhere.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_SIZE, _MARGIN = 560, 60
_DEPTH_PIXELS = 34.0
"""Of a frustum."""
_NAME_PIXELS = 14.0
"""Of a name from its camera."""
_MOST_STROKE = 5.0
_MOST_POINTS = 1500
_SHOWN_SHARE = 0.9
"""Of the points."""
_FAR = 3.0
"""Times the cameras' distance from one another that points are shown beyond them."""
_THUMBNAIL_WIDTH = 200
_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#222;background:#fff}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.3em .6em;border-bottom:1px solid #ddd}"
    "td,th{text-align:left;vertical-align:top}td.n{text-align:right;white-space:nowrap}.wide{overflow-x:auto}svg{max-width:100%;height:auto}"
    "svg text{font-size:12px}ul{padding-left:1.2em}"
)


def document(title: str, parts: Sequence[str]) -> str:
    """A page, HTML, of parts in HTML."""
    head = f'<html lang="en"><meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    return "\n".join(["<!doctype html>", head, f"<h1>{escape(title)}</h1>", *parts]) + "\n"


def listed(heading: str, items: Sequence[str]) -> Iterator[str]:
    """A heading and a list, where there is anything to list."""
    if items:
        yield f"<h2>{heading}</h2><ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def thumbnail(picture: U8) -> str:
    """A picture (H, W, 3) in the page itself."""
    height = max(1, round(picture.shape[0] * _THUMBNAIL_WIDTH / picture.shape[1]))
    small = cv2.resize(picture, (_THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA)
    data = base64.b64encode(cv2.imencode(".jpg", small[..., ::-1])[1].tobytes()).decode()
    return f"<img alt='' width='{_THUMBNAIL_WIDTH}' height='{height}' src='data:image/jpeg;base64,{data}'>"


def plan(
    cameras: Sequence[Camera],
    colours: Mapping[str, str],
    links: Mapping[tuple[str, str], int],
    points: F64 | None = None,
    *,
    from_side: bool = False,
) -> str:
    """Cameras from above or from the side, SVG, with what their pictures hold and what each two share.

    ``points`` (P, 3): what they see. Up is what most cameras hold up.
    """
    centres = np.array([camera_centre(camera) for camera in cameras])
    axes = plan_axes(cameras, from_side=from_side)
    reach = _FAR * float(np.linalg.norm(np.ptp(centres, axis=0)))
    low, high = _box(centres @ axes.T, None if points is None else points @ axes.T, reach)
    scale = (_SIZE - 2 * _MARGIN) / max(float((high - low).max()), 1e-9)

    def drawn(world_points: F64) -> F64:
        return np.asarray(_SIZE / 2 + scale * (world_points @ axes.T - (low + high) / 2))

    at = {camera.name: drawn(centre) for camera, centre in zip(cameras, centres, strict=True)}
    most = max(links.values(), default=1)
    parts = []
    if points is not None:
        shown = drawn(points[:: len(points) // _MOST_POINTS + 1])
        shown = shown[((shown > 0) & (shown < _SIZE)).all(axis=1)]
        parts += [f"<circle cx='{x:.1f}' cy='{y:.1f}' r='1' fill='#999'/>" for x, y in shown]
    for (one, two), count in links.items():
        (x1, y1), (x2, y2) = at[one], at[two]
        width = max(0.5, _MOST_STROKE * count / most)
        ends = f"x1='{x1:.1f}' y1='{y1:.1f}' x2='{x2:.1f}' y2='{y2:.1f}'"
        parts.append(f"<line {ends} stroke='#9ab' stroke-width='{width:.1f}' stroke-opacity='.5'/>")
    for camera in cameras:
        outline = drawn(_frustum(camera, _DEPTH_PIXELS / scale)).astype(np.float32)
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in cv2.convexHull(outline).reshape(-1, 2))
        way = outline[1:].mean(axis=0) - outline[0]
        x, y = outline[0] - _NAME_PIXELS * way / max(float(np.linalg.norm(way)), 1e-9)
        parts.append(
            f"<polygon points='{corners}' fill='{colours[camera.name]}' opacity='.85'/>"
            f"<text x='{x:.1f}' y='{y + 4:.1f}' text-anchor='middle'>{escape(camera.name)}</text>"
        )
    size = f"viewBox='0 0 {_SIZE} {_SIZE}' width='{_SIZE}'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' role='img' {size}>" + "".join(parts) + "</svg>"


def _box(centres: F64, points: F64 | None, reach: float) -> tuple[F64, F64]:
    """The plan's corners: all cameras, and most of the points, if they are within reach of these."""
    low, high = centres.min(axis=0), centres.max(axis=0)
    if points is not None and len(points):
        few = (1 - _SHOWN_SHARE) / 2
        seen_low, seen_high = np.quantile(points, [few, 1 - few], axis=0)
        low = np.minimum(low, np.maximum(seen_low, low - reach))
        high = np.maximum(high, np.minimum(seen_high, high + reach))
    return low, high


def plan_axes(cameras: Sequence[Camera], *, from_side: bool = False) -> F64:
    """The world's directions (2, 3) to the right and down in a plan."""
    rotations = np.array([camera.world_to_camera[:3, :3] for camera in cameras])
    up = -rotations[:, 1].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    across = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.8 else [0, 1.0, 0])
    across /= np.linalg.norm(across)
    return np.stack([across, -up if from_side else np.cross(up, across)])


def _frustum(camera: Camera, depth: float) -> F64:
    """The camera's centre, and the corners (5, 3) of its picture at a depth, in the world."""
    right, down = (
        (np.array([0, camera.width]) - camera.cx) / camera.fx,
        (np.array([0, camera.height]) - camera.cy) / camera.fy,
    )
    rays = np.array([[0.0, 0, 0], *([x, y, 1] for x in right for y in down)])
    return np.asarray(camera_centre(camera) + depth * rays @ camera.world_to_camera[:3, :3])
