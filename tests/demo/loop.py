"""A short loop that orbits while the scene plays, as animated WebP: what README.md and docs/see-it.md open with.

Run by ``make loop``: ``python tests/demo/loop.py demo/scene.dgs tests/demo/loop.webp``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

from decogs.decoder import open_stream, render_view
from decogs.decoder.cameras.moves import camera_move
from decogs.decoder.cameras.path import ToFilm
from decogs.decoder.output.pictures import to_8bit

FPS = 16
"""In 4 seconds the sample rig's nine frames then play forwards and backwards four times, and end where they begin."""
SCALE = 1.25
QUALITY = 60
MOST_BYTES = 1_500_000


def main(stream: str, output: str) -> None:
    with open_stream(stream) as opened:
        header = opened.header
        splats = [frame.splats for frame in opened.frames()]
        path = camera_move("orbit", ToFilm(header.cameras, FPS, len(splats)))
    views = zip(path.cameras, path.times, strict=True)
    seen = [render_view(header, splats[round(time)], camera, scale=SCALE).image for camera, time in views]
    animation = cv2.Animation()
    animation.frames = [cv2.cvtColor(to_8bit(picture), cv2.COLOR_RGB2BGR) for picture in seen]
    animation.durations = [round(1000 / FPS)] * len(seen)
    cv2.imwriteanimation(output, animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    size = Path(output).stat().st_size
    if size > MOST_BYTES:
        sys.exit(f"{output}: {size} bytes, more than the {MOST_BYTES} that a page may take")
    print(f"{output}: {len(seen)} pictures, {size} bytes")


if __name__ == "__main__":
    main(*sys.argv[1:])
