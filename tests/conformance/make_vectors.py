"""Writes the conformance vectors of a bitstream version: streams, and what a reader must make of each.

    python tests/conformance/make_vectors.py        into tests/conformance/1.0

Nothing depends on the machine or on a version of zstd: the few zstd frames are put together by hand or spelled out.
`large_vectors` are not kept as files; tests make them when they need them.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from plain_decoder import DELTA, END, HEADER, INDEX, KEY, MEANS, METRICS, SKIP, Header, Limits, State, digest, floats
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
    example_header,
    gap_varints,
    gaps,
    groups,
    in_morton_order,
    in_zstd,
    key_head,
    opened,
    packet,
    prologue,
    scene,
    stored,
    varint,
    with_degree,
    zstd_block,
    zstd_frame,
)

HERE = Path(__file__).parent
FOLDER = HERE / "1.0"
SPECIFICATION = HERE.parents[1] / "formats" / "SPEC.md"
LOWEST, HIGHEST = -(2**31), 2**31 - 1
LAST_ID = 2**63 - 1
DEFAULT_GAUSSIANS = 2_097_152
MAX_PAYLOAD = 268_435_456
EIGHT_MIB, NINE_MIB = 0x68, 0x69
"""Window descriptors of zstd frames (RFC 8878, section 3.1.1.1.2)."""

PLANES_OF_140 = bytes((i * i // 7) & 15 for i in range(420))
COMPRESSED = bytes.fromhex(
    "28b52ffd60a4005d010082430806707a0cc0f0640f2154870a63f99cca2d61dcb67d81b4277a73da80e21549c01f010098b6550505"
)
COMPRESSED_CHECKED = bytes.fromhex(
    "28b52ffd64a4005d010082430806707a0cc0f0640f2154870a63f99cca2d61dcb67d81b4277a73da80e21549c01f010098b6550505068367da"
)
"""PLANES_OF_140 as zstd 1.5.7 compresses it at level 19, without and with its checksum."""

PROVENANCE = """\
What:     conformance vectors of the .dgs bitstream, version 1.0 (formats/SPEC.md); ../README.md says how to use them
Made by:  tests/conformance/make_vectors.py, byte by byte; a test compares these files with what it makes
From:     nothing else: scenes are numbers from the mixing function of SPEC.md, section 5, and good/worked-example is
          the stream printed in section 12
zstd:     two blocks were compressed once by zstd 1.5.7 and are spelled out in the script; all others are stored, or raw
          and run-length zstd frames put together by hand
Licence:  Apache-2.0, as the project
"""


def vectors() -> Iterator[Vector]:
    """Every vector that is kept as a file."""
    yield from good_containers()
    yield from good_payloads()
    yield from good_states()
    yield from damaged_containers()
    yield from damaged_headers()
    yield from damaged_payloads()
    yield from damaged_blocks()
    yield from limits_of_headers()
    yield from limits_of_streams()


# Good


def good_containers() -> Iterator[Vector]:
    printed = re.search(r"```hex\n(.*?)```", SPECIFICATION.read_text(encoding="utf-8"), re.DOTALL)
    assert printed is not None
    yield replace(worked_example(), data=bytes.fromhex(printed.group(1)))

    yield Stream().good("good/no-frames")

    stream = moving()
    yield stream.good("good/no-index-no-end")

    stream = moving()
    stream.index()
    yield stream.good("good/index-without-end", indexes=[True])

    stream = moving()
    stream.end(with_index=False)
    yield stream.good("good/end-without-index")

    stream = opened()
    stream.index()
    stream.skip()
    stream.finish()
    yield stream.good("good/index-early-and-late", indexes=[True, True])

    stream = opened()
    stream.index([(stream.frames[0][0], 0, DELTA)])
    stream.index([(stream.frames[0][0] + 24, 0, KEY)])
    stream.add(INDEX, 0, struct.pack("<I", 7) + bytes(16))
    stream.skip()
    yield stream.good("good/wrong-indexes", indexes=[False, False, False])

    stream = Stream()
    stream.add(METRICS, 0, b'{"psnr": 30.5}')
    stream.key(stream.state(scene(2, 3, stream.width)))
    stream.add(METRICS, 0, b"")
    stream.add(0, 0, b"", flags=0)
    stream.add(8, 77, b"of a later version", flags=0)
    stream.skip()
    stream.add(128, 0, bytes(300), flags=0)
    stream.add(METRICS, 1, b"\xff\xfe")
    stream.finish()
    yield stream.good("good/ancillary-packets", indexes=[True])

    stream = opened(head=prologue(minor=7))
    stream.skip()
    stream.finish()
    yield stream.good("good/higher-minor-version", indexes=[True])

    stream = Stream(document=rich_header())
    stream.key(stream.state(scene(3, 4, stream.width)))
    stream.finish()
    yield stream.good("good/rich-header", indexes=[True])


def worked_example() -> Vector:
    """The stream of SPEC.md, section 12: its states are written there, its bytes are read from there."""
    stream = Stream()
    first = [
        [-2, 0, 0, -4, -5, -4, 2, 1, 0, 0, 3, 0, 8, 0],
        [1, 1, 0, -4, -4, -4, 2, 0, 0, 0, 3, 8, 0, 0],
        [300, 1, 2, -4, -4, -6, 2, 0, 0, 0, 3, 0, 0, 8],
    ]
    stream.key(stream.state(first))
    stream.delta({1: [2, 0, -1, *[0] * 11]}, [2], [[5, 5, 5, -4, -4, -4, 2, 0, 0, 0, 3, 1, 1, 1]])
    stream.skip()
    stream.finish()
    return stream.good("good/worked-example", indexes=[True])


def moving() -> Stream:
    """A key, a delta and a skip."""
    stream = opened()
    stream.delta({0: scene(4, 1, stream.width)[0]}, [2], scene(5, 2, stream.width))
    stream.skip()
    return stream


def rich_header() -> dict[str, Any]:
    """All kinds of cameras, unknown members, texts in many scripts, no canonical order."""
    document = changed("sh_degree", 1)
    camera = document["cameras"][0]
    c, s = 0.8, 0.6
    turned = [[c, -s, 0, 1e12], [s, c, 0, -2.5], [0, 0, 1, 3]]
    document["cameras"] = [
        {**camera, "name": "x" * 255, "distortion_model": "opencv", "distortion": [-0.3, 0.1, 0, 1e-4], "near": 0.25},
        {**camera, "name": "caméra \U0001f3a5", "distortion_model": "opencv", "distortion": [1e6, -1e6, 0, 0, 5]},
        {**camera, "name": "c", "distortion_model": "opencv", "distortion": [0.5, 0, 0, 0, 0, 0, 0, 1]},
        {**camera, "name": "...", "distortion_model": "fisheye", "distortion": [1, 2, 3, 4], "world_to_camera": turned},
        {**camera, "name": "\xa0", "later": {"version": [1, 2]}},
    ]
    texts = {
        "axes": "\u202e\x00\x1b[31m",
        "units": "m",
        "source_text": "\ud7ff\ue000\uffff",
        "licence": "",
        "writer": "by hand",
    }
    return {
        "zz_unknown": [[], {}, None, True, -0.0, 1e308],
        **document,
        **texts,
        "fps": 30000 / 1001,
        "background": [-1000, 0.5, 1000],
        "effects": ["motion", "motion", "lens_distortion", "view_dependence", "emergence", "disappearance"],
        "held_out": ["c", "c", *(camera["name"] for camera in document["cameras"])],
        "settings": {"preset": "none", "nested": [[[1]]], "big": 10**300},
    }


def good_payloads() -> Iterator[Vector]:
    for degree in range(4):
        stream = with_degree(degree)
        stream.key(stream.state(scene(6, 6, stream.width)))
        stream.delta(
            {1: scene(7, 1, stream.width)[0], 4: scene(8, 1, stream.width)[0]}, [0, 1], scene(9, 2, stream.width)
        )
        stream.skip()
        stream.finish()
        yield stream.good(f"good/sh-degree-{degree}", indexes=[True])
    yield from good_predictions()
    yield from good_index_sets()
    yield from good_blocks()

    stream = Stream()
    stream.key(
        stream.state(scene(10, 4, stream.width)),
        {group: Coding(counts=[4] * width) for group, width in enumerate([3, 3, 4, 1, 3])},
    )
    codes = [0, 1, 255, 65_535, 2**24 - 1, HIGHEST, 0, 0, 0, 0, -1, -128, -32_768, LOWEST]
    stream.delta({2: codes}, codings={2: Coding()})
    stream.delta({0: [0] * 14, 3: [0] * 14})
    yield stream.good("good/planes-0-to-4")


def good_predictions() -> Iterator[Vector]:
    for mode in (0, 1, 2):
        stream = with_degree(1)
        rows = [*scene(11, 5, stream.width), [LOWEST] * stream.width, [HIGHEST] * stream.width, [-1] * stream.width]
        extremes = [(LOWEST, HIGHEST, -5)[channel % 3] for channel in range(max(stream.header.channels))]
        codings = {
            g: Coding(mode, extremes[:width] if mode == 2 else ()) for g, width in enumerate(stream.header.channels)
        }
        stream.key(stream.state(rows), codings)
        stream.skip()
        yield stream.good(f"good/prediction-mode-{mode}")

    stream = Stream()
    rows, origin = in_morton_order(scene(12, 40, stream.width))
    stream.key(stream.state([*rows, rows[-1]]), {MEANS: Coding(3, origin)})
    more, origin = in_morton_order(scene(13, 3, stream.width))
    before = stream.states[-1]
    after = stream.state([*before.rows, *more], ids=range(44), next_id=44)
    added = groups(more, stream.header, {MEANS: Coding(3, origin, counts=[8], coder=in_zstd)})
    stream.told(DELTA, after, struct.pack("<Q", digest(after, stream.width)) + b"\0\0" + struct.pack("<I", 3) + added)
    yield stream.good("good/prediction-mode-3")

    stream = Stream()
    far = 2**21 - 1
    rows = [[LOWEST, 0, HIGHEST], [LOWEST + far, 0, HIGHEST], [LOWEST + far, far, LOWEST + far - 1]]
    stream.key(stream.state([[*mean, *[0] * 11] for mean in rows]), {MEANS: Coding(3, (LOWEST, 0, HIGHEST))})
    yield stream.good("good/morton-code-2-to-63-minus-1")


def good_index_sets() -> Iterator[Vector]:
    stream = Stream()
    stream.key(stream.state(scene(14, 9, stream.width)))
    one, rows = scene(15, 9, stream.width), range(9)
    stream.delta(dict(zip(rows, one, strict=True)), touched_set=b"\1")
    stream.delta({0: one[0], 8: one[8]}, touched_set=bitmap([0, 8], 9))
    stream.delta({8: one[1]}, touched_set=gaps([8]))
    stream.delta(dict(zip(rows, one, strict=True)), touched_set=gaps(rows, in_zstd))
    stream.delta({3: one[3]}, touched_set=bitmap([3], 9, in_zstd), removed_set=bitmap([], 9))
    stream.delta(removed=[0, 7], removed_set=gaps([0, 7]))
    stream.delta(removed=[6], removed_set=bitmap([6], 7))
    stream.delta(removed=list(range(6)), removed_set=b"\1")
    yield stream.good("good/index-sets")

    stream = Stream()
    stream.key(stream.state([[0] * 14] * 16_600))
    stream.delta({0: [1] + [0] * 13, 129: [2] + [0] * 13, 16_599: [3] + [0] * 13}, touched_set=gaps([0, 129, 16_599]))
    yield stream.good("good/gaps-of-three-bytes")

    stream = opened(3)
    stream.delta({0: [1] * 14, 1: [2] * 14}, removed=[1], added=[[7] * 14])
    stream.delta({2: [-9] * 14}, removed=[0, 1, 2], added=[[8] * 14])
    yield stream.good("good/touched-and-removed")

    stream = opened(3)
    after = stream.state(stream.states[-1].rows)
    told = struct.pack("<Q", digest(after, stream.width))
    nothing = struct.pack("<I", 0)
    stream.told(DELTA, after, told + bitmap([], 3) + b"\0" + nothing)
    stream.told(DELTA, replace(after, frame=2), told + b"\1\0" + b"\0" + nothing)
    yield stream.good("good/deltas-of-nothing")


def good_blocks() -> Iterator[Vector]:
    def means_from(block: bytes) -> Stream:
        """140 Gaussians whose positions are PLANES_OF_140."""
        stream = Stream()
        values = [(code >> 1) ^ -(code & 1) for code in PLANES_OF_140]
        state = stream.state([[*values[row::140], *[0] * 11] for row in range(140)])
        stream.told(KEY, state, key_head(state, stream.header) + b"\1\0\1\1\1" + block)
        return stream

    yield means_from(coded(1, COMPRESSED)).good("good/zstd-compressed")
    yield means_from(coded(1, COMPRESSED_CHECKED)).good("good/zstd-with-checksum")
    yield means_from(coded(1, zstd_frame(PLANES_OF_140, window=EIGHT_MIB))).good("good/zstd-window-8-mib")
    two = zstd_block(0, PLANES_OF_140[:20], last=False) + zstd_block(0, PLANES_OF_140[20:], last=True)
    yield means_from(coded(1, zstd_frame(PLANES_OF_140, blocks=two))).good("good/zstd-two-blocks")

    stream = Stream()
    state = stream.state([[1, 1, 1, *[0] * 11]] * 100)
    run = zstd_frame(bytes(300), blocks=zstd_block(1, b"\2", last=True, size=300))
    stream.told(KEY, state, key_head(state, stream.header) + b"\1\0\1\1\1" + coded(1, run))
    yield stream.good("good/zstd-run")


def good_states() -> Iterator[Vector]:
    stream = Stream()
    stream.key(stream.state([]))
    stream.delta(added=scene(16, 2, stream.width))
    stream.delta(removed=[0, 1], removed_set=b"\1")
    stream.delta(touched_set=b"\1", removed_set=bitmap([], 0))
    stream.skip()
    stream.key(stream.state([], next_id=9))
    state = stream.state([], next_id=0)
    stream.told(KEY, state, key_head(state, stream.header, id_mode=1) + stored(b"") + groups([], stream.header))
    stream.referring_key(added=scene(17, 1, stream.width), ids=[4], next_id=5)
    stream.finish()
    yield stream.good("good/empty-scenes", indexes=[True])

    stream = Stream()
    edges = [LOWEST, LOWEST + 1, -1, 0, 1, HIGHEST - 1, HIGHEST]
    rows = [[edges[(row + channel) % 7] for channel in range(stream.width)] for row in range(7)]
    stream.key(stream.state(rows))
    stream.delta({row: [edges[(row + 2 * channel) % 7] for channel in range(stream.width)] for row in range(7)})
    stream.delta({0: [HIGHEST] * 14, 1: [LOWEST] * 14}, touched_set=gaps([0, 1]))
    yield stream.good("good/wrap-around")

    lattice = example_header()["lattice"]
    far = {**lattice, "origin": [1e12, -1e12, 0.1], "means": [1e6, 1e-12, 0.1], "log_scales": 0.07, "sh_dc": 1e6}
    stream = Stream(changed("lattice", {**far, "opacity_logits": 0.3, "quaternions": 1 / 3, "sh_rest": 1e-12}))
    stream.key(stream.state([*rows, *scene(18, 9, stream.width, 2000), [0] * 14]))
    yield stream.good("good/floats")

    stream = Stream()
    ids = [3, 4, 3 + 2**35, 3 + 2**36, 3 + 2**36 + 129]
    stream.key(stream.state(scene(19, 5, stream.width), ids=ids, next_id=2**40))
    stream.delta(removed=[1, 3], added=scene(20, 2, stream.width))
    stream.key(stream.state(scene(19, 1, stream.width), ids=[17], next_id=18))
    state = stream.state(scene(19, 1, stream.width), ids=[17], next_id=18)
    listed = key_head(state, stream.header, id_mode=1, first_id=17) + stored(b"")
    stream.told(KEY, state, listed + groups(state.rows, stream.header))
    state = stream.state(scene(21, 4, stream.width), ids=[5, 6, 300, 70_000], next_id=70_001)
    listed = key_head(state, stream.header, id_mode=1, first_id=5) + in_zstd(gap_varints([6, 300, 70_000], 5))
    stream.told(KEY, state, listed + groups(state.rows, stream.header))
    yield stream.good("good/listed-ids")

    stream = Stream()
    stream.key(stream.state(scene(22, 2, stream.width), ids=[LAST_ID - 4, LAST_ID - 3], next_id=LAST_ID - 2))
    stream.delta(added=scene(23, 2, stream.width))
    stream.delta(removed=[0])
    stream.key(stream.state(scene(22, 2, stream.width), ids=[LAST_ID - 2, LAST_ID - 1]))
    yield stream.good("good/last-ids")

    yield referring().good("good/keys-that-refer", indexes=[True])


def referring() -> Stream:
    """Keyframes told as a change of the first one: none, all of it, ids listed, past another keyframe."""
    stream = with_degree(1)
    stream.key(stream.state(scene(24, 6, stream.width), ids=[1, 2, 3, 5, 8, 13], next_id=20))
    one = scene(25, 8, stream.width)
    stream.referring_key(next_id=20)
    stream.delta({0: one[0]}, [1], one[1:3])
    stream.referring_key({0: one[3], 5: one[4]}, [1, 2], one[5:7], [22, 23], next_id=24)
    stream.key(stream.state(scene(26, 2, stream.width)))
    stream.skip()
    stream.referring_key({1: one[5]}, [1], one[:3], [20, 25, 2**33], next_id=2**34, id_mode=1)
    stream.delta({3: one[6]}, added=one[:1])
    stream.referring_key(removed=range(6), next_id=14)
    stream.referring_key({5: one[7]}, added=one[:1], ids=[20], next_id=21, id_mode=1)
    stream.referring_key(id_mode=1, next_id=2**63 - 1)
    stream.finish()
    return stream


# Damaged


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
        "unknown-critical": packet(8, 1, told, flags=1),
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
        "unsupported-mode-values": late + b"\1\4\0\0\0" + stored(b""),
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


# Limits: the outermost value that is good, the innermost that is not


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


# Files


def outcome(vector: Vector) -> dict[str, Any]:
    """What a reader must make of a vector, as kept beside it; README.md says what the hashes are taken over."""
    limits = {} if vector.limits is None else {"limits": vars(vector.limits)}
    indexes = {"indexes": list(vector.indexes)} if vector.indexes else {}
    failure = None
    if vector.failure is not None:
        failure = dict(zip(("reason", "packet", "offset"), vector.failure, strict=True))
    frames = [] if vector.header is None else [hashes(state, vector.header) for state in vector.states]
    return {**limits, **indexes, "frames": frames, "failure": failure}


def hashes(state: State, header: Header) -> dict[str, Any]:
    integers = struct.pack("<QI", state.next_id, len(state.ids))
    for name, row in zip(state.ids, state.rows, strict=True):
        integers += struct.pack(f"<Q{len(row)}i", name, *row)
    shown = b"".join(struct.pack(f"<{len(row)}f", *row) for row in floats(state, header))
    return {
        "gaussians": len(state.ids),
        "digest": f"{digest(state, sum(header.channels)):016x}",
        "integers": hashlib.sha256(integers).hexdigest(),
        "floats": hashlib.sha256(shown).hexdigest(),
    }


def files() -> dict[str, bytes]:
    """Every file of the suite by its name in the folder."""
    made = list(vectors())
    names = [vector.name for vector in made]
    assert len(set(names)) == len(names), "two vectors have the same name"
    expected = {vector.name: outcome(vector) for vector in made}
    return {
        **{f"{vector.name}.dgs": vector.data for vector in made},
        "expected.json": (json.dumps(expected, indent=1, sort_keys=True) + "\n").encode(),
        "PROVENANCE": PROVENANCE.encode(),
    }


def main() -> None:
    """Writes the suite anew."""
    made = files()
    shutil.rmtree(FOLDER, ignore_errors=True)
    for name, data in made.items():
        path = FOLDER / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


if __name__ == "__main__":
    main()
