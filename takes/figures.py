"""Pictures and tables of errors, as parts of a page that holds all it shows."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from .compared import F64, U8, Compared, Pair

_PICTURE_WIDTH = 360
_RED_ERROR = 0.25
"""Difference, root mean square over colours, that is fully red in a map of errors."""
_LOW_DB, _HIGH_DB = 20.0, 36.0
"""Colours of the table of errors run between these."""


def error_table(compared: Compared) -> str:
    """PSNR of each camera and frame; held-out cameras are marked."""
    labels = [f"{name}{'*' if name in compared.held_out else ''}" for name in compared.cameras]
    return table(labels, compared.frames, compared.psnr, _cell)


def table(labels: Sequence[str], frames: Sequence[int], values: F64, cell: Callable[[float], str]) -> str:
    """A row a camera, a column a frame, and the mean of what is known."""
    rows = ["<tr><th>camera</th>" + "".join(f"<th>{frame}</th>" for frame in frames) + "<th>mean</th></tr>"]
    for label, row in zip(labels, values, strict=True):
        known = row[np.isfinite(row)]
        mean = float(known.mean()) if len(known) else float("nan")
        rows.append(f"<tr><th>{escape(label)}</th>" + "".join(map(cell, (*row.tolist(), mean))) + "</tr>")
    return f"<div class='wide'><table class='errors'>{''.join(rows)}</table></div>"


def pair_figure(pair: Pair) -> str:
    """What was recorded, what is shown, and where they differ."""
    caption = f"{pair.camera}, frame {pair.frame}: {pair.psnr:.2f} dB"
    return figure([pair.recorded, pair.shown, error_picture(pair)], caption)


def figure(pictures: Sequence[U8], caption: str) -> str:
    """Pictures beside each other."""
    return f"<figure>{''.join(map(_picture, pictures))}<figcaption>{escape(caption)}</figcaption></figure>"


def error_picture(pair: Pair) -> U8:
    """Errors in red over the recorded picture in grey."""
    error = np.clip(np.nan_to_num(np.sqrt(pair.error)) / _RED_ERROR, 0, 1)[..., None]
    grey = cv2.cvtColor(pair.recorded, cv2.COLOR_RGB2GRAY)[..., None].repeat(3, axis=2) // 2
    return np.asarray(error * np.array([255, 40, 40]) + (1 - error) * grey, np.uint8)


def in_text(data: bytes) -> str:
    """As an address of data has it."""
    return base64.b64encode(data).decode()


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return "<td>-</td>"
    share = float(np.clip((value - _LOW_DB) / (_HIGH_DB - _LOW_DB), 0, 1))
    return f"<td style='background:hsl({120 * share:.0f} 60% 80%)'>{value:.1f}</td>"


def _picture(picture: U8) -> str:
    width = min(_PICTURE_WIDTH, picture.shape[1])
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    coded = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
    return f"<img alt='' width='{width}' height='{height}' src='data:image/jpeg;base64,{in_text(coded.tobytes())}'> "
