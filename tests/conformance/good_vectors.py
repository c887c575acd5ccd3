"""Streams that decode to their end: every packet, mode, tag and degree that SPEC.md knows, extremes included."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from plain_container import DELTA, INDEX, KEY, MEANS, METRICS, SOUND
from plain_state import digest
from stream_writer import (
    Coding,
    Stream,
    Vector,
    bitmap,
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
    prologue,
    scene,
    stored,
    with_degree,
    zstd_block,
    zstd_frame,
)

SPECIFICATION = Path(__file__).parents[2] / "formats" / "SPEC.md"
LOWEST, HIGHEST = -(2**31), 2**31 - 1
LAST_ID = 2**63 - 1
EIGHT_MIB = 0x68
"""Window descriptor of a zstd frame (RFC 8878, section 3.1.1.1.2)."""

PLANES_OF_140 = bytes((i * i // 7) & 15 for i in range(420))
COMPRESSED = bytes.fromhex(
    "28b52ffd60a4005d010082430806707a0cc0f0640f2154870a63f99cca2d61dcb67d81b4277a73da80e21549c01f010098b6550505"
)
COMPRESSED_CHECKED = bytes.fromhex(
    "28b52ffd64a4005d010082430806707a0cc0f0640f2154870a63f99cca2d61dcb67d81b4277a73da80e21549c01f010098b6550505068367da"
)
"""PLANES_OF_140 as zstd 1.5.7 compresses it at level 19, without and with its checksum."""


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
    stream.add(9, 77, b"of a later version", flags=0)
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
    for mode in (0, 1, 2, 4):
        stream = with_degree(1)
        rows = [*scene(11, 5, stream.width), [LOWEST] * stream.width, [HIGHEST] * stream.width, [-1] * stream.width]
        extremes = [(LOWEST, HIGHEST, -5)[channel % 3] for channel in range(max(stream.header.channels))]
        codings = {
            g: Coding(mode, extremes[:width] if mode in (2, 4) else ())
            for g, width in enumerate(stream.header.channels)
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


def corrected_header() -> dict[str, Any]:
    """Four cameras: one is corrected in every way, one is held out."""
    document = example_header()
    camera = document["cameras"][0]
    return {
        **document,
        "cameras": [{**camera, "name": name} for name in "abcd"],
        "effects": ["white_balance_drift", "motion", "camera_shake", "exposure_drift"],
        "held_out": ["d"],
        "corrected": {"camera_shake": ["a", "b"], "exposure_drift": ["c", "a"], "white_balance_drift": ["a"]},
    }


def good_corrections() -> Iterator[Vector]:
    """All kinds of frames, each with numbers of its own; a later keyframe refers to the first."""
    stream = Stream(document=corrected_header())
    stream.corrections = faults(100)
    stream.key(stream.state(scene(30, 4, stream.width)))
    stream.corrections = faults(-32_768)
    stream.skip()
    stream.corrections = faults(32_767 - 8)
    stream.delta({1: scene(31, 1, stream.width)[0]})
    stream.corrections = faults(0)
    stream.referring_key(removed=[0], next_id=4)
    stream.finish()
    yield stream.good("good/corrections", indexes=[True])

    document = {**corrected_header(), "effects": ["camera_shake"], "corrected": {"camera_shake": ["c"], "later": 5}}
    stream = Stream(document=document)
    stream.corrections = {"c": {"yaw": -1, "pitch": 0, "roll": 1}}
    stream.key(stream.state([]))
    stream.skip()
    yield stream.good("good/corrections-of-one-effect")

    yield opened(document={**example_header(), "corrected": {}}).good("good/corrections-of-nothing")


def coloured_header() -> dict[str, Any]:
    """Four cameras: three have colours of their own, of which one is corrected in every frame too; one is held out."""
    document = corrected_header()
    colours = {"a": [32_767, -32_767, 0], "b": [0, 0, 0], "c": [-410, 12, 7]}
    cameras = [
        {**camera, **({"colours": colours[camera["name"]]} if camera["name"] in colours else {})}
        for camera in document["cameras"]
    ]
    return {
        **document,
        "cameras": cameras,
        "effects": ["colour_mismatch", "exposure_drift"],
        "corrected": {"exposure_drift": ["a"]},
    }


def good_colours() -> Iterator[Vector]:
    """Colours of cameras in the header: with corrections of one, and where no frame has any."""
    stream = Stream(document=coloured_header())
    stream.corrections = {"a": {"exposure": 32_767}}
    stream.key(stream.state(scene(33, 3, stream.width)))
    stream.corrections = {"a": {"exposure": -5}}
    stream.skip()
    stream.finish()
    yield stream.good("good/colours-and-corrections", indexes=[True])

    alone = {name: value for name, value in coloured_header().items() if name != "corrected"}
    yield opened(document={**alone, "effects": ["colour_mismatch"]}).good("good/colours-alone")
    yield opened(document=darkened_header()).good("good/falloff")
    stream = Stream(document=flickering_header())
    for phase, amplitude in ((-32_768, 4096), (32_767, 0)):
        stream.corrections = {
            "c": {"lamp_phase": phase, "lamp_amplitude": amplitude},
            "a": {"exposure": 7, "lamp_phase": 1, "lamp_amplitude": -1},
        }
        if phase < 0:
            stream.key(stream.state(scene(34, 1, stream.width)))
        else:
            stream.skip()
    yield stream.good("good/lamps")
    alone = {name: value for name, value in flickering_header().items() if name != "corrected"}
    yield opened(document={**alone, "effects": ["lamp_flicker"]}).good("good/lamps-alone")


def darkened_header() -> dict[str, Any]:
    """Cameras whose borders are darker: one of them with colours of its own, one without; one is held out."""
    document = {name: value for name, value in coloured_header().items() if name != "corrected"}
    falloffs = {"a": 1, "b": 32_767}
    cameras = [
        {
            **{member: value for member, value in camera.items() if member != "colours" or camera["name"] == "a"},
            **({"falloff": falloffs[camera["name"]]} if camera["name"] in falloffs else {}),
        }
        for camera in document["cameras"]
    ]
    return {**document, "cameras": cameras, "effects": ["colour_mismatch", "lens_falloff"]}


def flickering_header() -> dict[str, Any]:
    """Two cameras under lamps, at bounds: one with cells of its own, one whose exposure drifts, too."""
    document = corrected_header()
    bounds = [32_767, -32_767, 0]
    lamps = {
        "a": {"hertz": 1, "readout": -1, "columns": 1, "rows": 1, "sine": bounds, "cosine": [0, 0, 0]},
        "c": {"hertz": 1e6, "readout": 1, "columns": 16, "rows": 2, "sine": 32 * bounds, "cosine": 32 * [1, 2, 3]},
    }
    return {
        **document,
        "cameras": [
            {**camera, **({"lamp": lamps[camera["name"]]} if camera["name"] in lamps else {})}
            for camera in document["cameras"]
        ],
        "effects": ["exposure_drift", "lamp_flicker"],
        "corrected": {"exposure_drift": ["a"], "lamp_flicker": ["c", "a"]},
    }


def good_subjects() -> Iterator[Vector]:
    """A subject without a background decodes to the states it would have with one."""
    yield opened(document={**example_header(), "subject": True}).good("good/subject")


PLACED = [[0.0, 0.0, 2.0, 1.0], [2.0, 0.0, 0.0, -1e12], [0.0, 2.0, 0.0, 0.5]]
"""Twice as large, a third of a turn about the diagonal, and far away."""

PRESENTATION = {"title": "The f\u00eate", "poster": 2**31 - 1, "first_view": "a", "transform": PLACED}
"""Every member, at a bound where it has one."""


def scaled(by: float, across: float = 0.0) -> list[list[float]]:
    return [[by, by * across, 0, 0], [0, by, 0, 0], [0, 0, by, 0]]


ABSENT: dict[str, tuple[Any, ...]] = {
    "title": ("x" * 65_537, 5, None, ["x"]),
    "poster": (-1, 2**31, 1.0, True, "1"),
    "first_view": ("b", "", ["a"]),
    "transform": (
        None,
        [*PLACED, [0, 0, 0, 1]],
        [row[:3] for row in PLACED],
        [[*row[:3], "0"] for row in PLACED],
        [[*row[:3], True] for row in PLACED],
        [[*row[:3], 1.1e12] for row in PLACED],
        scaled(0),
        scaled(-1),
        scaled(0.9e-6),
        scaled(1.1e6),
        scaled(3, across=0.011),
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.1, 0]],
    ),
}
"""By member, values out of its bounds."""


def good_presentations() -> Iterator[Vector]:
    """A presentation changes no state, and what of it is out of bounds counts as absent."""
    yield opened(document={**example_header(), "presentation": PRESENTATION}).good("good/presentation")
    invented = {**PRESENTATION, "invented_later": {"x": 1}}
    yield opened(document={**example_header(), "presentation": invented}).good("good/presentation-member-of-later")
    for name, matrix in (("small", scaled(1.01e-6)), ("large", scaled(0.99e6)), ("slanted", scaled(3, across=0.0099))):
        document = {**example_header(), "presentation": {"transform": matrix}}
        yield opened(document=document).good(f"good/presentation-transform-{name}")
    for member, values in ABSENT.items():
        for number, value in enumerate(values):
            told = {**PRESENTATION, member: value}
            stream = opened(document={**example_header(), "presentation": told})
            yield stream.good(f"good/presentation-without-{member}-{number}")
    for number, value in enumerate(([], None, "title")):
        yield opened(document={**example_header(), "presentation": value}).good(f"good/presentation-none-{number}")


SOUND_TRACKS: list[dict[str, Any]] = [
    {"codec": "opus", "channels": 2, "title": "Räume", "position": [1, -2.5, 1e12]},
    {"codec": "opus", "channels": 1},
]
NO_SOUND: tuple[Any, ...] = (
    None,
    [*SOUND_TRACKS, {"codec": "aac", "channels": 2}],
    [*SOUND_TRACKS, {"codec": "opus", "channels": 3}],
    [*SOUND_TRACKS, {"codec": "opus", "channels": 1, "position": [0, 0, 1.1e12]}],
)
"""Lists of tracks that are out of their bounds."""

SILENCE = bytes.fromhex("fcfffe")
"""20 ms of stereo silence (RFC 6716, section 3.1: configuration 31, one frame)."""


def heard(tracks: Any, fps: float | None) -> Stream:
    return opened(document={**example_header(), "fps": fps, "sound": tracks})


def good_sounds() -> Iterator[Vector]:
    """Sound changes no state; what of it is out of bounds or damaged is not there."""
    stream = heard(SOUND_TRACKS, 30000 / 1001)
    stream.sound(0, -312, [SILENCE, SILENCE])
    stream.sound(0, 0, [b"\xff"], track=1)
    stream.skip()
    stream.sound(1, 1608, [SILENCE, bytes(1276)])
    stream.skip()
    for frame in (1, 3):
        stream.add(SOUND, frame, struct.pack("<Bi", 0, 0) + b"\3\0" + SILENCE, flags=0)
    stream.sound(2, 9_000_000, [SILENCE])
    stream.finish()
    yield stream.good("good/sound", indexes=[True])
    stream = heard(SOUND_TRACKS, 25)
    for payload in (b"", b"\0", struct.pack("<Bi", 0, 0), struct.pack("<Bi", 2, 0) + b"\1\0\xff"):
        stream.add(SOUND, 0, payload, flags=0)
    for payload in (b"\0\0", b"\1\0\xff\0\0", b"\2\0\xff", b"\1\0\xff\1", b"\xfd\4" + bytes(1277)):
        stream.add(SOUND, 0, struct.pack("<Bi", 0, 0) + payload, flags=0)
    stream.sound(0, 5, [SILENCE])
    stream.finish()
    yield stream.good("good/sound-that-is-damaged", indexes=[True])
    yield heard([{**SOUND_TRACKS[0], "invented_later": 1}] * 16, 1).good("good/sound-of-many-tracks")
    for number, tracks in enumerate(NO_SOUND):
        yield heard(tracks, 24).good(f"good/sound-none-{number}")
    for name, fps in (("unknown", None), ("slow", 0.99)):
        yield heard(SOUND_TRACKS, fps).good(f"good/sound-none-at-{name}-rate")


def faults(first: int) -> dict[str, dict[str, int]]:
    """Numbers of `corrected_header`, counted up from the first."""
    return {
        "c": {"exposure": first},
        "a": {"exposure": first + 1, "red": first + 2, "blue": first + 3}
        | {"yaw": first + 4, "pitch": first + 5, "roll": first + 6},
        "b": {"yaw": first + 7, "pitch": first + 8, "roll": 5},
    }
