"""The outermost value that is good, and the innermost that is not (SPEC.md, section 8)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

from damaged_vectors import with_header
from plain_container import DELTA, KEY, METRICS, Limits
from stream_writer import (
    Stream,
    Vector,
    canonical,
    changed,
    coded,
    example_header,
    gaps,
    opened,
    scene,
    zstd_block,
    zstd_frame,
)

DEFAULT_GAUSSIANS = 2_097_152
MAX_PAYLOAD = 268_435_456


def limits_of_headers() -> Iterator[Vector]:
    for path, within, beyond in MEMBER_LIMITS:
        for word, values, reason in (("within", within, None), ("beyond", beyond, "bad-header")):
            for number, value in enumerate(values):
                name = f"limits/header-{path.replace('.', '-')}-{word}-{number}"
                yield with_header(name, canonical(changed(path, value)), reason)
    for depth, reason in ((14, None), (15, "bad-header")):
        nested: Any = 1
        for level in range(depth):
            nested = [nested] if level % 2 else {"a": nested}
        # The header itself and the settings are two more.
        payload = canonical(changed("settings", {"brackets": '[[[["{{{{\\"', "nested": nested}))
        yield with_header(f"limits/header-nested-{depth + 2}-deep", payload, reason)


def with_lens(coefficient: float) -> dict[str, Any]:
    camera = example_header()["cameras"][0]
    return {**camera, "distortion_model": "fisheye", "distortion": [0.0, coefficient, 0.0, 0.0]}


MEMBER_LIMITS: tuple[tuple[str, list[Any], list[Any]], ...] = (
    ("cameras.0.width", [1, 32_768], [0, 32_769]),
    ("cameras.0.height", [1, 32_768], [0, 32_769]),
    ("cameras.0.fx", [1e-3, 1e9], [9.99e-4, 1.001e9]),
    ("cameras.0.fy", [1e-3, 1e9], [9.99e-4, 1.001e9]),
    ("cameras.0.cx", [-1e9, 1e9], [-1.001e9, 1.001e9]),
    ("cameras.0.cy", [-1e9, 1e9], [-1.001e9, 1.001e9]),
    ("cameras.0.near", [0, 1e12], [-1e-9, 1.001e12]),
    ("cameras.0.name", ["é" * 255, "\U0001f3a5" * 255], ["é" * 256]),
    ("cameras.0.world_to_camera.0.3", [-1e12, 1e12], [-1.001e12, 1.001e12]),
    ("cameras.0.world_to_camera.0.0", [1.0049, 0.9951], [1.0051, 0.9948]),
    ("lattice.origin.1", [-1e12, 1e12], [-1.001e12, 1.001e12]),
    ("lattice.means.0", [1e-12, 1e6], [9e-13, 1.001e6]),
    ("lattice.log_scales", [1e-12, 1e6], [9e-13, 1.001e6]),
    ("lattice.quaternions", [1e-12, 0.5], [9e-13, 0.501]),
    ("lattice.opacity_logits", [1e-12, 1e6], [9e-13, 1.001e6]),
    ("lattice.sh_dc", [1e-12, 1e6], [9e-13, 1.001e6]),
    ("lattice.sh_rest", [1e-12, 1e6], [9e-13, 1.001e6]),
    ("cameras.0", [with_lens(1e6), with_lens(-1e6)], [with_lens(1.001e6), with_lens(-1.001e6)]),
    ("sh_degree", [0], [-1, 4]),
    ("fps", [1e-6, 1e6], [9e-7, 1.001e6]),
    ("first_frame", [0, 2**31 - 1], [-1, 2**31]),
    ("background.1", [-1000, 1000], [-1000.001, 1000.001]),
)


def limits_of_streams() -> Iterator[Vector]:
    over = struct.pack("<4sBBHII", b"DGSP", METRICS, 0, 0, 0, MAX_PAYLOAD + 1)
    at = struct.pack("<4sBBHII", b"DGSP", METRICS, 0, 0, 0, MAX_PAYLOAD)
    for name, head, reason in (("beyond", over, "too-large"), ("within", at, "truncated")):
        stream = opened()
        stream.raw(head + zlib.crc32(head).to_bytes(4, "little") + b"and so on")
        yield stream.broken(f"limits/payload-length-{name}", reason)

    stream = opened()
    stream.add(METRICS, 0, bytes(600))
    yield stream.good("limits/payload-of-600", limits=Limits(payload_bytes=600))
    yield stream.broken("limits/payload-above-599", "too-large", limits=Limits(payload_bytes=599))

    stream = opened()
    stream.add(KEY, 1, struct.pack("<QQIBBQ", 0, 2**40, DEFAULT_GAUSSIANS + 1, 0, 0, 0) + b"\0")
    yield stream.broken("limits/gaussians-of-a-key", "too-many-gaussians")
    stream = opened()
    stream.add(DELTA, 1, bytes(8) + b"\0" + gaps([0]) + struct.pack("<I", DEFAULT_GAUSSIANS - 3) + b"\0")
    yield stream.broken("limits/gaussians-of-a-delta", "too-many-gaussians")

    stream = opened()
    stream.delta(removed=[0], added=scene(1, 3, stream.width))
    stream.key(stream.state(scene(2, 7, stream.width)))
    stream.referring_key(removed=[0, 1], added=scene(3, 4, stream.width), ids=range(9, 13), next_id=20)
    yield stream.good("limits/seven-gaussians", limits=Limits(gaussians=7))
    six = Limits(gaussians=6)
    stream = opened()
    stream.delta(removed=[0], added=scene(1, 3, stream.width))
    del stream.states[-1]
    yield stream.broken("limits/six-gaussians-delta", "too-many-gaussians", limits=six)
    stream = opened()
    stream.key(stream.state(scene(2, 7, stream.width)))
    del stream.states[-1]
    yield stream.broken("limits/six-gaussians-key", "too-many-gaussians", limits=six)
    stream = opened()
    stream.referring_key(removed=[0, 1], added=scene(3, 4, stream.width), ids=range(9, 13), next_id=20)
    del stream.states[-1]
    yield stream.broken("limits/six-gaussians-referring-key", "too-many-gaussians", limits=six)

    # A single segment's window is its content: 12 planes of 2^20 Gaussians are above 8 MiB.
    runs = b"".join(zstd_block(1, b"\0", last=block == 95, size=1 << 17) for block in range(96))
    frame = zstd_frame(b"", declared=12 << 20, blocks=runs)
    stream = Stream()
    stream.add(KEY, 0, struct.pack("<QQIBBQ", 0, 1 << 20, 1 << 20, 0, 0, 0) + b"\1\0\4\4\4" + coded(1, frame))
    yield stream.broken("limits/zstd-single-segment-12-mib", "bad-compression")


def large_vectors() -> Iterator[Vector]:
    """Limits of headers that only large files reach; not kept."""
    padding = (1 << 20) - len(canonical(changed("padding", "")))
    for more, reason in ((0, None), (1, "too-large")):
        yield with_header(f"large/header-{more}", canonical(changed("padding", "x" * (padding + more))), reason)
    for more, reason in ((0, None), (1, "bad-header")):
        for text in ("axes", "units", "source_text", "licence", "writer"):
            long = canonical(changed(text, "\U0001f3a5" * (65_536 + more)))
            yield with_header(f"large/{text}-{more}", long, reason)
        camera = example_header()["cameras"][0]
        cameras = [{**camera, "name": str(number)} for number in range(1024 + more)]
        yield with_header(f"large/cameras-{more}", canonical(changed("cameras", cameras)), reason)
        yield with_header(f"large/effects-{more}", canonical(changed("effects", ["motion"] * (1024 + more))), reason)
        yield with_header(f"large/held-out-{more}", canonical(changed("held_out", ["a"] * (1024 + more))), reason)
