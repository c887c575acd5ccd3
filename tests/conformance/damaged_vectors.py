"""Streams with one fault each: every reason code of SPEC.md, section 9, at least once."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

from good_vectors import (
    COMPRESSED,
    COMPRESSED_CHECKED,
    LAST_ID,
    PLANES_OF_140,
    coloured_header,
    corrected_header,
    darkened_header,
    faults,
    flickering_header,
    moving,
    worked_example,
)
from plain_container import DELTA, END, HEADER, INDEX, KEY, METRICS, SKIP, SOUND
from plain_header import Header
from plain_state import digest
from stream_writer import (
    MISSING,
    Coding,
    Stream,
    Vector,
    attribute_group,
    bitmap,
    canonical,
    changed,
    coded,
    corrections_block,
    example_header,
    gaps,
    groups,
    key_head,
    opened,
    packet,
    prologue,
    scene,
    stored,
    varint,
    zstd_block,
    zstd_frame,
)

NINE_MIB = 0x69
"""Window descriptor of a zstd frame (RFC 8878, section 3.1.1.1.2)."""


def damaged_containers() -> Iterator[Vector]:
    whole = worked_example().data
    opening = {
        "bad-signature-empty-name": b"\x8bDGX" + whole[4:],
        "bad-signature-png": b"\x89PNG\r\n\x1a\n" + whole[8:],
        "bad-signature-short": b"\x8bDX",
        "bad-signature-too-short-for-text-damage": b"\x8bDGS\n",
        "text-damage-short": b"\x8bDGS\n\x1a",
        "text-damage-line-feeds": whole.replace(b"\r\n", b"\n"),
        "text-damage-carriage-returns": whole.replace(b"\n", b"\r\n"),
        "text-damage-seven-bits": bytes(byte & 0x7F for byte in whole),
        "unsupported-version-0": prologue(major=0) + whole[16:],
        "unsupported-version-2": prologue(major=2) + whole[16:],
        "reserved-bits-prologue": prologue(reserved=0x8000) + whole[16:],
        "bad-header-crc-prologue": whole[:9] + b"\1" + whole[10:],
        "truncated-empty-file": b"",
        "truncated-signature": whole[:5],
        "truncated-prologue": whole[:15],
    }
    for name, data in opening.items():
        reason = next(code for code in OPENING_REASONS if name.startswith(code))
        yield Vector(f"damaged/{name}", data, None, (), (reason, None, 0))
    yield Vector("damaged/truncated-before-header", whole[:16], None, (), ("truncated", 0, 16))

    stream = moving()
    ends = {
        "sync": 2,
        "packet-header": 19,
        "payload": 21,
        "payload-checksum": len(stream.data) - stream.offsets[-1] - 1,
    }
    for name, size in ends.items():
        stream = moving()
        del stream.states[-1]
        cut = stream.broken(f"damaged/truncated-in-{name}", "truncated")
        yield replace(cut, data=cut.data[: stream.offsets[-1] + size])
    yield from damaged_packets()
    yield from misplaced_packets()


OPENING_REASONS = (
    "bad-signature",
    "text-damage",
    "unsupported-version",
    "reserved-bits",
    "bad-header-crc",
    "truncated",
)


def damaged_packets() -> Iterator[Vector]:
    told = struct.pack("<Q", 0)
    skipped = packet(SKIP, 1, told)
    packets = {
        "bad-sync": b"DGSQ" + skipped[4:],
        "bad-sync-tail": b"\n",
        "bad-header-crc": skipped[:8] + b"\2" + skipped[9:],
        "bad-header-crc-itself": skipped[:16] + b"\0\0\0\0" + skipped[20:],
        "bad-payload-crc": skipped[:20] + b"\1" + skipped[21:],
        "bad-payload-crc-itself": skipped[:-4] + b"\0\0\0\0",
        "reserved-bits-flag": packet(SKIP, 1, told, flags=3),
        "reserved-bits-flag-of-unknown-kind": packet(200, 1, told, flags=128),
        "reserved-bits-after-flags": packet(SKIP, 1, told, reserved=1),
        "reserved-bits-frame": packet(SKIP, 2**31, told),
        "reserved-bits-skip-not-critical": packet(SKIP, 1, told, flags=0),
        "reserved-bits-index-critical": packet(INDEX, 0, bytes(4), flags=1),
        "reserved-bits-metrics-critical": packet(METRICS, 0, b"", flags=1),
        "reserved-bits-sound-critical": packet(SOUND, 1, b"", flags=1),
        "unknown-critical": packet(9, 1, told, flags=1),
        "unknown-critical-0": packet(0, 1, told, flags=1),
        "unknown-critical-255": packet(255, 0, b"", flags=1),
        "misplaced-packet-second-header": packet(HEADER, 0, canonical(example_header())),
        "bad-payload-end-short": packet(END, 0, struct.pack("<IQ", 1, 0)[:-1]),
        "bad-payload-end-long": packet(END, 0, struct.pack("<IQ", 1, 0) + b"\0"),
        "index-mismatch-end-counts-more": packet(END, 0, struct.pack("<IQ", 2, 0)),
        "index-mismatch-end-counts-less": packet(END, 0, struct.pack("<IQ", 0, 0)),
        "bad-payload-skip-long": packet(SKIP, 1, told + b"\0"),
        "bad-payload-skip-short": packet(SKIP, 1, told[:-1]),
        "digest-mismatch-skip": packet(SKIP, 1, told),
        "frame-order-skip-again": packet(SKIP, 0, told),
        "frame-order-skip-gap": packet(SKIP, 2, told),
        "frame-order-delta-gap": packet(DELTA, 9, told),
    }
    for name, data in packets.items():
        stream = opened()
        stream.raw(data)
        yield stream.broken(f"damaged/{name}", reason_in(name))


def misplaced_packets() -> Iterator[Vector]:
    for name, first in {"key": packet(KEY, 0, b""), "metrics": packet(METRICS, 0, b"")}.items():
        stream = Stream()
        data = prologue() + first + stream.data[16:]
        yield Vector(f"damaged/misplaced-packet-{name}-first", data, None, (), ("misplaced-packet", 0, 16))

    for name, data in {"byte": b"\0", "packet": packet(METRICS, 0, b"")}.items():
        stream = opened()
        stream.finish()
        stream.raw(data)
        yield stream.broken(f"damaged/trailing-data-{name}", "trailing-data", indexes=[True])

    for name, kind in {"delta": DELTA, "skip": SKIP}.items():
        stream = Stream()
        stream.add(kind, 0, bytes(8))
        yield stream.broken(f"damaged/missing-key-{name}", "missing-key")

    for name, frame in {"gap": 2, "again": 0}.items():
        stream = opened()
        state = stream.states[-1]
        stream.add(KEY, frame, key_head(state, stream.header) + groups(state.rows, stream.header))
        yield stream.broken(f"damaged/frame-order-key-{name}", "frame-order")
    stream = Stream()
    stream.add(KEY, 1, key_head(stream.state([]), stream.header) + b"\0")
    yield stream.broken("damaged/frame-order-first-key", "frame-order")


def reason_in(name: str) -> str:
    """The reason code that a vector's name begins with."""
    return max((code for code in REASONS if name.startswith(code)), key=len)


REASONS = (
    *OPENING_REASONS,
    *("bad-sync", "bad-payload-crc", "too-large", "unknown-critical", "misplaced-packet", "trailing-data"),
    *("index-mismatch", "bad-header", "unsupported-effect", "unsupported-mode", "bad-payload", "bad-index-set"),
    *("bad-compression", "too-many-gaussians", "missing-key", "frame-order", "digest-mismatch"),
)


def damaged_headers() -> Iterator[Vector]:
    text = canonical(example_header())
    texts = {
        "empty": b"",
        "no-object": b"[" + text + b"]",
        "cut": text[:-1],
        "trailing": text + b"x",
        "byte-order-mark": b"\xef\xbb\xbf" + text,
        "utf-16": text.decode().encode("utf-16"),
        "not-utf-8": text.replace(b'"axes":""', b'"axes":"\xff"'),
        "surrogate-in-utf-8": text.replace(b'"axes":""', b'"axes":"\xed\xa0\x80"'),
        "half-a-surrogate-pair": text.replace(b'"axes":""', b'"axes":"\\ud83c"'),
        "half-a-surrogate-pair-in-a-name": text.replace(b'"settings":{}', b'"settings":{"\\udfa5":1}'),
        "first-surrogate": text.replace(b'"axes":""', b'"axes":"\\ud800"'),
        "last-surrogate": text.replace(b'"axes":""', b'"axes":"\\udfff"'),
        "control-character": text.replace(b'"axes":""', b'"axes":"\n"'),
        "name-twice": text.replace(b'"axes":""', b'"axes":"","axes":""'),
        "name-twice-inside": text.replace(b'"settings":{}', b'"settings":{"a":[{"b":1,"b":1}]}'),
        "nan": text.replace(b'"fps":null', b'"fps":NaN'),
        "infinity": text.replace(b'"settings":{}', b'"settings":{"a":-Infinity}'),
        "number-too-large": text.replace(b'"settings":{}', b'"settings":{"a":1e309}'),
        "integer-too-large": text.replace(b'"settings":{}', b'"settings":{"a":1' + b"0" * 309 + b"}"),
        "leading-zero": text.replace(b'"first_frame":0', b'"first_frame":00'),
        "trailing-comma": text.replace(b'"settings":{}', b'"settings":{},'),
        "comment": text + b"/**/",
    }
    for name, payload in texts.items():
        assert payload != text
        yield with_header(f"damaged/bad-header-{name}", payload, "bad-header")
    for number, (path, value) in enumerate(BAD_MEMBERS):
        name = f"damaged/bad-header-member-{number:02}-{path.replace('.', '-')}"
        yield with_header(name, canonical(changed(path, value)), "bad-header")
    second = [*example_header()["cameras"] * 2]
    yield with_header("damaged/bad-header-same-names", canonical(changed("cameras", second)), "bad-header")
    unknown = canonical(changed("effects", ["motion", "smell"]))
    yield with_header("damaged/unsupported-effect", unknown, "unsupported-effect")


def damaged_corrections() -> Iterator[Vector]:
    document = corrected_header()
    right = document["corrected"]
    wrong = {
        "no-object": {"corrected": ["camera_shake"]},
        "absent": {"corrected": {}},
        "empty-list": {"corrected": {**right, "camera_shake": []}},
        "no-list": {"corrected": {**right, "camera_shake": "a"}},
        "effect-not-named": {"effects": ["exposure_drift", "camera_shake"]},
        "unknown-camera": {"corrected": {**right, "camera_shake": ["e"]}},
        "camera-twice": {"corrected": {**right, "exposure_drift": ["a", "c", "a"]}},
        "held-out-camera": {"corrected": {**right, "exposure_drift": ["d"]}},
    }
    for name, change in wrong.items():
        yield with_header(f"damaged/bad-header-corrected-{name}", canonical({**document, **change}), "bad-header")
    without = canonical({name: value for name, value in document.items() if name != "corrected"})
    yield with_header("damaged/bad-header-corrected-missing", without, "bad-header")

    stream = Stream(document=document)
    stream.corrections = faults(7)
    stream.key(stream.state(scene(32, 2, stream.width)))
    block = corrections_block(faults(8), stream.header)
    told = struct.pack("<Q", digest(stream.states[0], stream.width))
    payloads = {
        "bad-payload-corrections-cut": block[:-1],
        "bad-payload-corrections-alone": block,
        "bad-payload-corrections-twice": block * 2 + told,
        "bad-payload-corrections-missing": told,
        "digest-mismatch-behind-corrections": block + bytes(8),
    }
    for name, payload in payloads.items():
        broken = deepcopy(stream)
        broken.add(SKIP, 1, payload)
        yield broken.broken(f"damaged/{name}", reason_in(name))


def damaged_colours() -> Iterator[Vector]:
    document = coloured_header()

    def of_camera(number: int, colours: Any) -> bytes:
        cameras = deepcopy(document["cameras"])
        cameras[number]["colours"] = colours
        return canonical({**document, "cameras": cameras})

    wrong = {
        "no-list": of_camera(0, {"exposure": 1}),
        "two-numbers": of_camera(0, [1, 2]),
        "four-numbers": of_camera(0, [1, 2, 3, 4]),
        "fraction": of_camera(0, [1.0, 2, 3]),
        "truth": of_camera(0, [True, 2, 3]),
        "too-large": of_camera(0, [0, 32_768, 0]),
        "too-small": of_camera(0, [0, 0, -32_768]),
        "held-out-camera": of_camera(3, [1, 2, 3]),
        "effect-not-named": canonical({**document, "effects": ["exposure_drift"]}),
        "absent": canonical({**corrected_header(), "effects": [*corrected_header()["effects"], "colour_mismatch"]}),
    }
    for name, payload in wrong.items():
        yield with_header(f"damaged/bad-header-colours-{name}", payload, "bad-header")
    dark = darkened_header()

    def darker(number: int, falloff: Any) -> bytes:
        cameras = deepcopy(dark["cameras"])
        cameras[number]["falloff"] = falloff
        return canonical({**dark, "cameras": cameras})

    wrong = {
        "none": darker(0, 0),
        "held-out-camera": darker(3, 5),
        "effect-not-named": canonical({**dark, "effects": ["colour_mismatch"]}),
        "absent": canonical({**corrected_header(), "effects": [*corrected_header()["effects"], "lens_falloff"]}),
    }
    for name, payload in wrong.items():
        yield with_header(f"damaged/bad-header-falloff-{name}", payload, "bad-header")
    flickering = flickering_header()

    def lit(number: int, **members: Any) -> bytes:
        cameras = deepcopy(flickering["cameras"])
        cameras[number]["lamp"] = {**flickering["cameras"][0]["lamp"], **members}
        return canonical({**flickering, "cameras": cameras})

    wrong = {
        "held-out-camera": lit(3),
        "effect-not-named": canonical(
            {**flickering, "effects": ["exposure_drift"], "corrected": {"exposure_drift": ["a"]}}
        ),
        "too-slow": lit(0, hertz=0.5),
        "no-cells": lit(0, columns=0, sine=[], cosine=[]),
        "too-many-cells": lit(0, rows=17, sine=17 * [0, 0, 0], cosine=17 * [0, 0, 0]),
        "cells-are-missing": lit(0, columns=2),
        "absent": canonical({**flickering, "cameras": corrected_header()["cameras"]}),
    }
    for name, payload in wrong.items():
        yield with_header(f"damaged/bad-header-lamp-{name}", payload, "bad-header")


def with_header(name: str, payload: bytes, reason: str | None) -> Vector:
    """A stream of a header packet and a keyframe; a broken header leaves nothing to decode."""
    stream = opened()
    packets = [packet(HEADER, 0, payload), stream.data[stream.offsets[1] :]]
    data = prologue() + b"".join(packets)
    if reason is None:
        return replace(stream.good(name), data=data, header=Header(1, json.loads(payload)["lattice"]))
    return Vector(name, data, None, (), (reason, 0, 16))


BAD_MEMBERS: tuple[tuple[str, Any], ...] = (
    *((member, MISSING) for member in sorted(example_header())),
    *((f"cameras.0.{member}", MISSING) for member in sorted(example_header()["cameras"][0])),
    *((f"lattice.{member}", MISSING) for member in sorted(example_header()["lattice"])),
    ("cameras", {}),
    ("cameras", []),
    ("cameras.0", "a"),
    ("cameras.0.width", 4.0),
    ("cameras.0.width", True),
    ("cameras.0.fx", "5"),
    ("cameras.0.fy", False),
    ("cameras.0.cx", None),
    ("cameras.0.name", ""),
    ("cameras.0.name", "a/b"),
    ("cameras.0.name", "a\\b"),
    ("cameras.0.name", "."),
    ("cameras.0.name", ".."),
    ("cameras.0.name", "a\n"),
    ("cameras.0.name", "\x7f"),
    ("cameras.0.name", "\x9f"),
    ("cameras.0.name", 5),
    ("cameras.0.distortion_model", "magic"),
    ("cameras.0.distortion_model", 5),
    ("cameras.0.distortion_model", "fisheye"),
    ("cameras.0.distortion", [0.0]),
    ("cameras.0.distortion", "none"),
    ("cameras.0.near", None),
    ("cameras.0.near", -1e-9),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0]]),
    ("cameras.0.world_to_camera", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]),
    ("cameras.0.world_to_camera", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.006, 0]]),
    ("cameras.0.world_to_camera", [[1, 0.011, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
    ("cameras.0.world_to_camera", [[1e12, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
    ("lattice", [1]),
    ("lattice.means", 0.5),
    ("lattice.means", [0.5, 0.5]),
    ("lattice.means.2", -0.5),
    ("lattice.quaternions", [0.5]),
    ("sh_degree", 1.0),
    ("sh_degree", "1"),
    ("sh_degree", True),
    ("fps", "25"),
    ("fps", True),
    ("first_frame", None),
    ("background", [0, 0]),
    ("background", [0, 0, "0"]),
    ("effects", "motion"),
    ("effects", [5]),
    ("effects", ["a/b"]),
    ("effects", [""]),
    ("effects", ["x" * 256]),
    ("held_out", ["b"]),
    ("held_out", "a"),
    ("axes", 5),
    ("writer", None),
    ("settings", []),
    *(("subject", value) for value in (False, None, 1, "true")),
)


def damaged_payloads() -> Iterator[Vector]:
    """One keyframe of five Gaussians, then a delta or a key with one fault."""
    stream = opened()
    five, width = stream.states[0], stream.width
    told = struct.pack("<Q", digest(five, width))
    values = groups(five.rows, stream.header)
    head = key_head(five, stream.header)
    nothing = struct.pack("<I", 0)
    one = struct.pack("<I", 1)
    means = attribute_group([row[:3] for row in five.rows], 3, Coding())
    quiet = b"\0"
    deltas = {
        "bad-payload-empty": b"",
        "bad-payload-cut": told + b"\0\0" + nothing[:3],
        "bad-payload-long": told + b"\0\0" + nothing + b"\0",
        "bad-payload-set-missing": told,
        "bad-payload-values-missing": told + b"\0\0" + one,
        "unsupported-mode-index-set": told + b"\4\0" + nothing,
        "unsupported-mode-removed-set": told + b"\0\xff" + nothing,
        "unsupported-mode-codec": told + b"\2" + coded(2, b"\1") + quiet + b"\0" + nothing,
        "unsupported-mode-residual-1": told + b"\1\1\1" + means[1:] + b"\0" + nothing,
        "unsupported-mode-residual-2": told + b"\1\1\2" + bytes(12) + means[1:] + b"\0" + nothing,
        "unsupported-mode-residual-3": told + b"\1\1\3" + bytes(13) + stored(b"") + b"\0" + nothing,
        "unsupported-mode-residual-4": told + b"\1\1\4" + bytes(12) + means[1:] + b"\0" + nothing,
        "reserved-bits-presence-6": told + b"\1\x40\0" + nothing,
        "reserved-bits-presence-7": told + b"\1\x80\0" + nothing,
        "reserved-bits-presence-no-sh": told + b"\1\x20\0" + nothing,
        "bad-payload-plane-count": told + b"\1\1\0\5\0\0" + stored(bytes(25)) + b"\0" + nothing,
        "bad-payload-planes-short": told + b"\1\1\0\1\0\0" + stored(bytes(4)) + b"\0" + nothing,
        "bad-payload-planes-long": told + b"\1\1\0\1\0\0" + stored(bytes(6)) + b"\0" + nothing,
        "bad-payload-bitmap-long": told + b"\2" + stored(b"\1\0") + quiet + b"\0" + nothing,
        "bad-payload-block-beyond-end": told + b"\2" + struct.pack("<BI", 0, 2**32 - 1) + b"\1",
        "bad-payload-gaps-short": told + b"\3" + one + stored(b"") + quiet + b"\0" + nothing,
        "bad-payload-gaps-long": told + b"\3" + one + stored(bytes(6)) + quiet + b"\0" + nothing,
        "bad-index-set-bitmap-beyond": told + bitmap([5], 6) + quiet + b"\0" + nothing,
        "bad-index-set-none": told + b"\3" + nothing + stored(b"") + b"\0" + nothing,
        "bad-index-set-too-many": told + b"\3" + struct.pack("<I", 6) + stored(bytes(6)) + quiet + b"\0" + nothing,
        "bad-index-set-row": told + gaps([0, 5]) + quiet + b"\0" + nothing,
        "bad-index-set-removed-row": told + b"\0" + gaps([5]) + nothing,
        "bad-index-set-far-row": told + b"\3" + one + stored(varint(2**35 - 1)) + quiet + b"\0" + nothing,
        "bad-index-set-varint-not-shortest": told + b"\3" + one + stored(b"\x81\0") + quiet + b"\0" + nothing,
        "bad-index-set-varint-six-bytes": told
        + b"\3\2\0\0\0"
        + stored(b"\x80\x80\x80\x80\x80\1\1")
        + b"\0\0"
        + nothing,
        "bad-index-set-varint-unfinished": told + b"\3" + one + stored(b"\x80") + quiet + b"\0" + nothing,
        "bad-index-set-one-number-too-many": told + b"\3" + one + stored(b"\0\0") + quiet + b"\0" + nothing,
        "bad-index-set-one-number-too-few": told + b"\3\2\0\0\0" + stored(b"\x81\1") + quiet + b"\0" + nothing,
        "digest-mismatch-delta": bytes(8) + b"\0\0" + nothing,
    }
    late = struct.pack("<QQIBBQ", 0, 10, 1, 0, 0, 9)
    morton = b"\1\3" + bytes(12)
    keys = {
        "bad-payload-key-empty": b"",
        "bad-payload-key-cut-in-head": head[:29],
        "bad-payload-key-cut": head + values[:-1],
        "bad-payload-key-long": head + values + b"\0",
        "bad-payload-key-no-values": head,
        "unsupported-mode-reference": head[:20] + b"\2" + head[21:] + values,
        "unsupported-mode-ids": head[:21] + b"\2" + head[22:] + stored(bytes(4)) + values,
        "unsupported-mode-values": late + b"\1\5\0\0\0" + stored(b""),
        "unsupported-mode-morton-scales": late + b"\2\3" + bytes(13) + stored(b""),
        "bad-payload-morton-planes": late + morton + b"\x09" + stored(bytes(9)),
        "bad-payload-morton-code": late + morton + b"\x08" + stored(bytes(7) + b"\x80"),
        "bad-payload-morton-wraps": struct.pack("<QQIBBQ", 0, 2, 2, 0, 0, 0) + morton + b"\x08" + stored(b"\1\xff" * 8),
        "reserved-bits-key-presence": late + b"\x40",
        "reserved-bits-key-presence-no-sh": late + b"\x20\0" + stored(b""),
        "bad-payload-next-id-below": head[:8] + struct.pack("<Q", 4) + head[16:] + values,
        "bad-payload-next-id-2-to-63": head[:8] + struct.pack("<Q", 2**63) + head[16:] + values,
        "bad-payload-first-id-2-to-63": head[:22] + struct.pack("<Q", 2**63) + values,
        "bad-payload-ids-pass-2-to-63": struct.pack("<QQIBBQ", 0, LAST_ID, 2, 0, 0, LAST_ID - 1) + b"\0",
        "bad-payload-listed-ids-pass-2-to-63": struct.pack("<QQIBBQ", 0, LAST_ID, 2, 0, 1, LAST_ID - 5)
        + stored(varint(9))
        + b"\0",
        "bad-payload-first-id-of-nothing": struct.pack("<QQIBBQ", 0, 10, 0, 0, 0, 9) + b"\0",
        "bad-index-set-id-varint": struct.pack("<QQIBBQ", 0, 10, 2, 0, 1, 0) + stored(b"\x80\0") + b"\0",
        "bad-index-set-id-varint-six-bytes": struct.pack("<QQIBBQ", 0, 2**40, 3, 0, 1, 0)
        + stored(b"\x80\x80\x80\x80\x80\1\0")
        + b"\0",
        "bad-payload-ids-short": struct.pack("<QQIBBQ", 0, 10, 3, 0, 1, 0) + stored(b"\0") + b"\0",
        "digest-mismatch-key": bytes(8) + head[8:] + values,
        "too-many-gaussians-key": struct.pack("<QQIBBQ", 0, 2**32, 2**32 - 1, 0, 0, 0) + b"\0",
    }
    referred = struct.pack("<QQIBBQ", 0, 10, 5, 1, 0, 0)
    keys |= {
        "bad-payload-reference-count": referred[:16] + struct.pack("<I", 6) + referred[20:] + b"\0\0" + nothing,
        "bad-payload-reference-count-removed": referred + b"\0" + gaps([1]) + nothing,
        "bad-payload-reference-first-id": referred[:22] + struct.pack("<Q", 7) + b"\0\0" + nothing,
        "bad-payload-reference-old-id": struct.pack("<QQIBBQ", 0, 10, 6, 1, 0, 4) + b"\0\0" + one + b"\0",
        "bad-payload-reference-next-id": struct.pack("<QQIBBQ", 0, 4, 5, 1, 0, 0) + b"\0\0" + nothing,
        "bad-index-set-reference-row": referred + gaps([5]) + b"\0\0" + nothing,
        "unsupported-mode-reference-residual": referred + b"\1\1\1" + means[1:] + b"\0" + nothing,
        "digest-mismatch-reference": referred + b"\0\0" + nothing,
    }
    for kind, payloads in ((DELTA, deltas), (KEY, keys)):
        for name, payload in payloads.items():
            stream = opened()
            stream.add(kind, 1, payload)
            yield stream.broken(f"damaged/{name}", reason_in(name))
    stream = Stream()
    stream.add(KEY, 0, referred + b"\0\0" + nothing)
    yield stream.broken("damaged/missing-key-first-refers", "missing-key")
    stream = Stream()
    stream.key(stream.state(scene(1, 1, width), ids=[LAST_ID - 2], next_id=LAST_ID - 1))
    stream.add(DELTA, 1, bytes(8) + b"\0\0" + struct.pack("<I", 2) + b"\0")
    yield stream.broken("damaged/bad-payload-ids-run-out", "bad-payload")


def damaged_blocks() -> Iterator[Vector]:
    """A key whose only group, positions, is a zstd frame of 420 bytes with one fault."""
    raw = PLANES_OF_140
    frames = {
        "no-frame": raw,
        "empty": b"",
        "magic": b"\x29" + COMPRESSED[1:],
        "skippable-frame": b"\x50\x2a\x4d\x18" + struct.pack("<I", 420) + raw,
        "cut": COMPRESSED[:-1],
        "damaged": COMPRESSED[:20] + b"\xff" + COMPRESSED[21:],
        "trailing-byte": COMPRESSED + b"\0",
        "two-frames": zstd_frame(raw[:200], declared=420) + zstd_frame(raw[200:]),
        "skippable-frame-after": COMPRESSED + b"\x50\x2a\x4d\x18\0\0\0\0",
        "checksum": COMPRESSED_CHECKED[:-1] + b"\0",
        "declares-less": zstd_frame(raw, declared=419),
        "declares-more": zstd_frame(raw, declared=421),
        "holds-less": zstd_frame(raw[:-1], declared=420),
        "holds-more": zstd_frame(raw + b"\0", declared=420),
        "other-size": zstd_frame(raw + b"\0"),
        "size-not-declared": b"\x28\xb5\x2f\xfd\0\0" + zstd_block(0, raw, last=True),
        "window-9-mib": zstd_frame(raw, window=NINE_MIB),
        "dictionary": b"\x28\xb5\x2f\xfd\xa1\7" + struct.pack("<I", 420) + zstd_block(0, raw, last=True),
        "reserved-bit": b"\x28\xb5\x2f\xfd\xa8" + struct.pack("<I", 420) + zstd_block(0, raw, last=True),
        "reserved-block": zstd_frame(raw, blocks=zstd_block(3, raw, last=True)),
        "no-last-block": zstd_frame(raw, blocks=zstd_block(0, raw, last=False)),
    }
    for name, frame in frames.items():
        stream = Stream()
        stream.add(KEY, 0, struct.pack("<QQIBBQ", 0, 140, 140, 0, 0, 0) + b"\1\0\1\1\1" + coded(1, frame))
        yield stream.broken(f"damaged/bad-compression-{name}", "bad-compression")

    empties = {
        "nothing": zstd_frame(b""),
        "nothing-trailing": zstd_frame(b"") + b"garbage",
        "skippable-nothing": b"\x50\x2a\x4d\x18\0\0\0\0",
    }
    for name, frame in empties.items():
        stream = Stream()
        stream.add(KEY, 0, struct.pack("<QQIBBQ", 0, 1, 1, 0, 0, 0) + b"\1\0\0\0\0" + coded(1, frame))
        yield stream.broken(f"damaged/bad-compression-{name}", "bad-compression")
