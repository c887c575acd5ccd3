"""A short, seeded run of what ``make fuzz`` does at length, the inputs it once found, and that its judge can fail."""

from __future__ import annotations

import importlib.util
import io
import re
import sys
import time
from itertools import islice
from pathlib import Path
from random import Random

import numpy as np
import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import StreamError
from packets import iterate_packets

spec = importlib.util.spec_from_file_location("hostile", Path(__file__).with_name("hostile.py"))
hostile = importlib.util.module_from_spec(spec)
sys.modules["hostile"] = hostile
spec.loader.exec_module(hostile)

FOUND = Path(__file__).with_name("found")


@pytest.fixture
def targets(tmp_path: Path) -> dict:
    parsers = {name: target for name, (target, _) in hostile.parsers().items()}
    path = tmp_path / "x.dgs"
    return {"streams": hostile.FileTarget(path), "edits": hostile.EditTarget(path), **parsers}


def test_mutated_streams_are_read_or_refused(targets) -> None:
    judge = hostile.Judge(targets["streams"])
    for data in islice(hostile.mutants(hostile.seed_streams(), seed=11), 200):
        judge.try_one(data)
    assert judge.tried == 200


def test_mutated_streams_are_edited_or_refused(targets) -> None:
    judge = hostile.Judge(targets["edits"])
    for data in islice(hostile.mutants(hostile.seed_streams(), seed=13), 200):
        judge.try_one(data)
    assert judge.tried == 200


@pytest.mark.parametrize("edits", hostile.EDITS, ids=lambda edits: edits[0].name)
def test_whole_streams_are_edited(edits, tmp_path: Path) -> None:
    """Else the fuzzing would try refusals alone."""
    target = hostile.EditTarget(tmp_path / "x.dgs")
    for data in hostile.seed_streams():
        target.path.write_bytes(data)
        with open_stream(target.path) as stream:
            empty = not len(next(stream.frames()).state)
        operations = [target._of_this(each) for each in edits]
        if not (empty and edits[0].name in ("crop", "clean")):
            hostile.edit(target.path, tmp_path / "out.dgs", operations)


@pytest.mark.parametrize("name", ["container", "header", "payload"])
def test_mutated_parser_inputs_are_read_or_refused(name: str) -> None:
    target, seeds = hostile.parsers()[name]
    judge, random = hostile.Judge(target), Random(12)
    for _ in range(600):
        judge.try_one(hostile.mutated_bytes(random, random.choice(seeds)))


@pytest.mark.parametrize("path", sorted(FOUND.glob("*-*")), ids=lambda path: path.name)
def test_inputs_that_once_misbehaved(targets, path: Path) -> None:
    hostile.Judge(targets[path.name.split("-")[0]]).try_one(path.read_bytes())


def test_every_found_input_has_its_line() -> None:
    listed = re.findall(r"^\| `([^`]+)` \| ", (FOUND / "README.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(path.name for path in FOUND.glob("*-*"))


def test_seeds_are_whole_and_structured_mutants_get_past_the_checksums(tmp_path: Path) -> None:
    """Else the fuzzing would try little more than checksums."""
    random, reasons, reconstructed = Random(3), set(), 0
    for data in hostile.seed_streams():
        (tmp_path / "x.dgs").write_bytes(data)
        with open_stream(tmp_path / "x.dgs", strict=True) as stream:
            right = {frame.state.row_sum for frame in stream.frames()}
            assert stream.frame_count >= 4
        parsed = list(iterate_packets(io.BytesIO(data)))
        for _ in range(60):
            (tmp_path / "x.dgs").write_bytes(hostile.mutated_stream(random, parsed))
            found = []
            try:
                with open_stream(tmp_path / "x.dgs", on_damage=found.append) as stream:
                    reconstructed += not {frame.state.row_sum for frame in stream.frames()} <= right
            except StreamError as error:
                reasons.add(error.reason)
            reasons.update(damage.error.reason for damage in found)
    assert reconstructed > 50, "mutants with states that are others, digests and all"
    assert {"bad-payload", "bad-index-set", "unsupported-mode", "frame-order", "bad-header"} <= reasons
    assert not {"bad-header-crc", "bad-payload-crc", "bad-sync"} & reasons


def test_the_same_seed_gives_the_same_mutants() -> None:
    once, again = (list(islice(hostile.mutants(hostile.seed_streams(), seed=5), 20)) for _ in range(2))
    assert once == again


def raises(data: bytes) -> None:
    raise IndexError(data)


def lasts(data: bytes) -> None:
    began = time.process_time()
    while time.process_time() < began + hostile.MAX_SECONDS:
        pass


def grows(data: bytes) -> None:
    np.ones(hostile.MAX_MEMORY + (8 << 20), np.uint8)


@pytest.mark.parametrize(("target", "message"), [(raises, "IndexError"), (lasts, "it took 1"), (grows, "MiB")])
def test_the_judge_sees_what_misbehaves(target, message: str) -> None:
    with pytest.raises(hostile.Misbehaved, match=message):
        hostile.Judge(target).try_one(b"")
