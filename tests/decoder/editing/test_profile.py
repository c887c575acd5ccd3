"""Profiles of streams: said by an edit, measured by decogs-info, true after other edits."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from decogs.codec.header import profiles
from decogs.codec.header.profiles import PROFILES
from decogs.decoder.commands import info_main
from decogs.decoder.editing import Set, Trim, edit
from decogs.decoder.editing.operations.profile import KeepProfile
from decogs.decoder.reading.info import info
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import UsageError
from edited_streams import header_of, states_of
from layered_streams import layered


@pytest.fixture
def narrow_phone(monkeypatch: pytest.MonkeyPatch, small_stream) -> int:
    """A phone that holds all Gaussians of the small stream but one; returns how many."""
    most = max(len(state) for state in states_of(small_stream.path)) - 1
    phone = replace(PROFILES["phone"], gaussians=most)
    monkeypatch.setitem(PROFILES, "phone", phone)
    monkeypatch.setattr(profiles, "_RISING", (phone, *profiles._RISING[1:]))
    return most


def test_an_edit_says_it_and_no_frame_changes(small_stream, tmp_path: Path) -> None:
    out = tmp_path / "out.dgs"
    report = edit(small_stream.path, out, [KeepProfile("headset")])
    assert header_of(out).profiles == ("phone",)
    assert report.kept_packets == report.frame_count
    edit(out, tmp_path / "trimmed.dgs", [Trim(slice(1, 4))])
    assert header_of(tmp_path / "trimmed.dgs").profiles == ("phone",)
    edit(small_stream.path, tmp_path / "other.dgs", [Set(title="x")])
    assert header_of(tmp_path / "other.dgs").profiles == ()


def test_a_stream_that_asks_for_more_is_refused(small_stream, narrow_phone: int, tmp_path: Path) -> None:
    out = tmp_path / "out.dgs"
    with pytest.raises(UsageError, match=f"it has up to {narrow_phone + 1} Gaussians, of {narrow_phone}"):
        edit(small_stream.path, out, [KeepProfile("phone")])
    assert not out.exists()
    assert info_main([str(small_stream.path), "--profile", "phone"]) == 2
    assert info_main([str(small_stream.path), "--profile", "headset"]) == 0


def test_the_base_is_held_to_it_and_all_layers_say_theirs(small_stream, narrow_phone: int, tmp_path: Path) -> None:
    layers, out = layered(small_stream.path, tmp_path / "layered.dgs"), tmp_path / "out.dgs"
    edit(layers, out, [KeepProfile("phone")])
    assert header_of(out).profiles == ("phone", "headset")
    assert [load.profile for load in info(out).loads] == ["phone", "headset"]
    info(out).check(PROFILES["phone"])


def test_info_measures_what_the_header_says(small_stream, tmp_path: Path, monkeypatch, capsys) -> None:
    """The same from packets on disk as from those that were written; what is not so is said."""
    out = layered(small_stream.path, tmp_path / "layered.dgs")
    edit(out, tmp_path / "said.dgs", [KeepProfile("phone")])
    facts = info(tmp_path / "said.dgs")
    for said, measured in zip(facts.header.layers, facts.loads, strict=True):
        assert measured.gaussians == said.gaussians
    info_main([str(tmp_path / "said.dgs"), "--json", "-q"])
    assert json.loads(capsys.readouterr().out)["profiles"] == ["phone", "phone"]
    narrow = replace(PROFILES["phone"], gaussians=3)
    monkeypatch.setitem(PROFILES, "phone", narrow)
    monkeypatch.setattr(profiles, "_RISING", (narrow, *profiles._RISING[1:]))
    info_main([str(tmp_path / "said.dgs"), "-q"])
    text = capsys.readouterr().out
    assert "profile      layer 0: headset" in text
    assert "NOT AS SAID  layer 0: the header says phone, but it has up to" in text


def test_of_a_damaged_stream_nothing_is_said(small_stream, tmp_path: Path) -> None:
    data = bytearray(small_stream.path.read_bytes())
    with open_stream(small_stream.path) as stream:
        later = sum(frame.packet_bytes for frame in stream.frames(1))
    data[-later] ^= 1
    damaged = tmp_path / "damaged.dgs"
    damaged.write_bytes(data)
    with pytest.raises(UsageError, match="leaves open"):
        info(damaged).check(PROFILES["phone"])


def test_there_are_no_other_profiles(small_stream, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="choose from phone, headset, desktop"):
        edit(small_stream.path, tmp_path / "out.dgs", [KeepProfile("watch")])
