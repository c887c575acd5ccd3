"""Writes the conformance vectors of a bitstream version: streams, and what a reader must make of each.

    python tests/conformance/make_vectors.py        into tests/conformance/1.0.tar and 1.1.tar

An archive is stored as it is, uncompressed: its bytes depend on no library, and Git compresses it anyway.
Nothing depends on the machine or on a version of zstd: the few zstd frames are put together by hand or spelled out.
`limit_vectors.large_vectors` are not kept as files; tests make them when they need them.
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from damaged_vectors import (
    damaged_blocks,
    damaged_colours,
    damaged_containers,
    damaged_corrections,
    damaged_headers,
    damaged_payloads,
)
from good_vectors import (
    good_colours,
    good_containers,
    good_corrections,
    good_payloads,
    good_presentations,
    good_sounds,
    good_states,
    good_subjects,
)
from layer_vectors import layer_vectors
from limit_vectors import limits_of_headers, limits_of_streams
from plain_header import Header
from plain_state import State, digest, floats
from stream_writer import Vector

FOLDER = Path(__file__).parent

PROVENANCE = """\
What:     conformance vectors of the .dgs bitstream, version {} (formats/SPEC.md); tests/conformance/README.md says how
          to use them
Made by:  tests/conformance/make_vectors.py, byte by byte; a test compares this archive with what it makes
From:     nothing else: scenes are numbers from the mixing function of SPEC.md, section 5, and good/worked-example is
          the stream printed in section 12
zstd:     two blocks were compressed once by zstd 1.5.7 and are spelled out in the script; all others are stored, or raw
          and run-length zstd frames put together by hand
Licence:  Apache-2.0, as the project
"""


def plain_vectors() -> Iterator[Vector]:
    """Every vector of version 1.0 that is kept as a file."""
    yield from good_containers()
    yield from good_payloads()
    yield from good_states()
    yield from good_corrections()
    yield from good_colours()
    yield from good_subjects()
    yield from good_presentations()
    yield from good_sounds()
    yield from damaged_containers()
    yield from damaged_headers()
    yield from damaged_payloads()
    yield from damaged_blocks()
    yield from damaged_corrections()
    yield from damaged_colours()
    yield from limits_of_headers()
    yield from limits_of_streams()


VERSIONS = {"1.0": plain_vectors, "1.1": layer_vectors}


def outcome(vector: Vector) -> dict[str, Any]:
    """What a reader must make of a vector, as kept beside it; README.md says what the hashes are taken over."""
    limits = {} if vector.limits is None else {"limits": vars(vector.limits)}
    indexes = {"indexes": list(vector.indexes)} if vector.indexes else {}
    failure = None
    if vector.failure is not None:
        failure = dict(zip(("reason", "packet", "offset"), vector.failure, strict=True))
    frames = [] if vector.header is None else [hashes(state, vector.header) for state in vector.states]
    shown = {} if vector.header is None else vector.header.presentation
    tracks = [] if vector.header is None else vector.header.sound
    heard = {"sound": {"tracks": tracks, "packets": heard_packets(vector.sounds)}} if tracks else {}
    profiles = {} if vector.header is None or not vector.header.profiles else {"profiles": vector.header.profiles}
    told = {**limits, **indexes, **heard, **layers(vector), **profiles}
    return {**told, "frames": frames, "failure": failure, **({"presentation": shown} if shown else {})}


def layers(vector: Vector) -> dict[str, Any]:
    """What a reader must make of each layer above the base; nothing where there is none."""
    if vector.header is None or not vector.layers:
        return {}
    told = [[hashes(state, vector.header) for state in states] for states in vector.layers]
    return {"layers": {"frames": told, "failure": vector.layer_fault}}


def heard_packets(sounds: Iterable[Any]) -> list[list[Any]]:
    """Of each SOUND packet that can be played: track, first sample, number of blocks, their hash."""
    return [
        [each.track, each.first, len(each.blocks), hashlib.sha256(b"".join(each.blocks)).hexdigest()] for each in sounds
    ]


def hashes(state: State, header: Header) -> dict[str, Any]:
    integers = struct.pack("<QI", state.next_id, len(state.ids))
    for name, row in zip(state.ids, state.rows, strict=True):
        integers += struct.pack(f"<Q{len(row)}i", name, *row)
    shown = b"".join(struct.pack(f"<{len(row)}f", *row) for row in floats(state, header))
    told = {"corrections": state.corrections} if state.corrections else {}
    return {
        **told,
        "gaussians": len(state.ids),
        "digest": f"{digest(state, sum(header.channels)):016x}",
        "integers": hashlib.sha256(integers).hexdigest(),
        "floats": hashlib.sha256(shown).hexdigest(),
    }


def files(version: str) -> dict[str, bytes]:
    """Every file of the suite of a version by its name in the archive's folder."""
    made = list(VERSIONS[version]())
    names = [vector.name for vector in made]
    assert len(set(names)) == len(names), "two vectors have the same name"
    expected = {vector.name: outcome(vector) for vector in made}
    return {
        **{f"{vector.name}.dgs": vector.data for vector in made},
        "expected.json": (json.dumps(expected, indent=1, sort_keys=True) + "\n").encode(),
        "PROVENANCE": PROVENANCE.format(version).encode(),
    }


def archive(version: str, named: dict[str, bytes]) -> bytes:
    """The files as an archive, in the order of their names, with neither times nor owners."""
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, data in sorted(named.items()):
            member = tarfile.TarInfo(f"{version}/{name}")
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return made.getvalue()


def path_of(version: str) -> Path:
    """The committed archive."""
    return FOLDER / f"{version}.tar"


def kept(version: str) -> dict[str, bytes]:
    """The files of the committed archive, as `files` names them."""
    with tarfile.open(path_of(version)) as tar:
        return {member.name.removeprefix(f"{version}/"): tar.extractfile(member).read() for member in tar}


def main() -> None:
    """Writes the suites anew."""
    for version in VERSIONS:
        path_of(version).write_bytes(archive(version, files(version)))


if __name__ == "__main__":
    main()
