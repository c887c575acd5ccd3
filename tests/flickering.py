"""Pictures of a wall under lamps that flicker over a rolling shutter, as a camera records them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

HEIGHT, WIDTH = 96, 64
Pulse = Callable[[np.ndarray], np.ndarray]
"""Factor of the light by time, in seconds."""


def recorded(
    pulse: Pulse,
    rate: float,
    readout: float,
    *,
    frames: int = 20,
    phase: float = 0.0,
    seed: int = 0,
    bright: float = 0.4,
    other: Pulse | None = None,
) -> np.ndarray:
    """Pictures (F, H, W, 3) of a wall, a light that grows a little, and a thing that falls; noise of a level.

    ``other``: the pulse of another lamp, which lights the right half instead.
    """
    random = np.random.default_rng(seed)
    wall = bright * (0.5 + np.cumsum(random.normal(0, 0.05, (HEIGHT, WIDTH)), axis=0).clip(-0.3, 0.3))
    rows, made = (np.arange(HEIGHT) + 0.5) / HEIGHT, []
    for frame in range(frames):
        light = wall * (1 + 0.01 * frame)
        light[3 * frame % HEIGHT :][:16, 10:20] = 0.8 * bright
        times = frame / rate + readout * rows + phase
        factors = np.repeat(pulse(times)[:, None], WIDTH, axis=1)
        if other is not None:
            factors[:, WIDTH // 2 :] = other(times)[:, None]
        coded = 255 * np.clip(light * factors, 0, 1) ** (1 / 2.2) + random.normal(0, 1.2, light.shape)
        made.append(np.clip(np.rint(coded), 0, 255).astype(np.uint8))
    return np.repeat(np.stack(made)[..., None], 3, axis=3)


def lamp(hertz: float, amplitude: float, turns: float = 0.0) -> Pulse:
    return lambda time: 1 + amplitude * np.sin(2 * np.pi * (hertz * time + turns))
