"""The canary's figures: what every way of encoding makes of every rig, from keyframes committed beside this file.

    python tests/canary/figures.py            # shows what changed against expected.json
    python tests/canary/figures.py --write    # and makes it the new expectation
    python tests/canary/figures.py --keyframes --write    # trains the keyframes anew, too

From a given keyframe the bytes of later frames are the same on every x86-64 machine with the same releases
(constraints.txt), so a digest that differs means that something changed what is encoded.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent)] * (str(HERE.parent) not in sys.path)

from canary.rigs import HELD_OUT, RIGS, write_rig  # noqa: E402
from decogs.encoder import EffectChoice  # noqa: E402
from decogs.encoder.analysis.analyse import analyse  # noqa: E402
from decogs.encoder.job.switches import with_method  # noqa: E402
from decogs.encoder.settings.encode import EncodeSettings  # noqa: E402
from decogs.encoder.settings.presets import LADDER, preset  # noqa: E402
from decogs.formats.stream.container import PacketKind  # noqa: E402
from encode_rig import encode_rig as encode  # noqa: E402
from packets import iterate_packets  # noqa: E402

EXPECTED = HERE / "expected.json"
TOLERANCE = 0.02
"""dB; the bytes are compared exactly, so this only forgives how a machine measures."""
WAYS: dict[str, EncodeSettings] = {
    **{name: preset(name) for name in (*LADDER, "paper")},
    "closed": replace(preset("draft"), closed=True, segment=2),
    "3dgstream": with_method(preset("draft"), "3dgstream"),
}
"""How every rig is encoded: the presets, closed segments with a cross-fade, and the dense baseline."""
_EFFECTS = EffectChoice("none", {"motion", "appearance_change", "emergence", "disappearance"})


def keyframe_of(name: str) -> Path:
    return HERE / f"{name}.dgs"


def train_keyframe(name: str, rig: Path) -> None:
    """A small keyframe of the rig's first frame, written beside this file."""
    settings = replace(preset("draft"), keyframe=replace(preset("draft").keyframe, cap=1500))
    encode(rig, keyframe_of(name), settings, frames=slice(1), holdout=[HELD_OUT], effects=_EFFECTS, threads=1)


def measure(name: str, way: str, rig: Path, folder: Path) -> dict[str, Any]:
    """Bytes, digest and PSNR of the frames after the first."""
    output = folder / f"{name}-{way}.dgs"
    settings = WAYS[way]
    effects = None if settings.method == "3dgstream" else _EFFECTS
    report = encode(rig, output, settings, holdout=[HELD_OUT], keyframe=keyframe_of(name), effects=effects, threads=2)
    later = report.frames[1:]
    with output.open("rb") as stream:
        packets = [packet for packet in iterate_packets(stream) if packet.kind != PacketKind.INDEX and packet.frame]
    digest = hashlib.sha256(b"".join(packet.payload for packet in packets)).hexdigest()[:16]
    return {
        "kinds": " ".join(frame.kind for frame in later),
        "bytes": [frame.bytes for frame in later],
        "digest": digest,
        "training": round(fmean(frame.training_psnr for frame in later), 3),
        "held_out": round(fmean(frame.held_out_psnr or 0.0 for frame in later), 3),
    }


def effects_of(rig: Path) -> list[str]:
    """What the rig as a whole is found to call for."""
    analysis = analyse(rig, holdout=[HELD_OUT], threads=2)
    return [decision.effect for decision in analysis.decisions if decision.detected]


def all_figures(folder: Path, *, keyframes: bool = False) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for name in RIGS:
        rig = write_rig(name, folder / name)
        if keyframes:
            train_keyframe(name, rig)
        figures[name] = {"effects": effects_of(rig)}
        figures[name] |= {way: measure(name, way, rig, folder) for way in WAYS}
    return figures


def show(old: dict[str, Any], new: dict[str, Any]) -> None:
    """One line a figure that changed, or one that says that none did."""
    changed = 0
    for name, rig in new.items():
        for entry, now in rig.items():
            before = old.get(name, {}).get(entry)
            if before == now:
                continue
            changed += 1
            if entry == "effects" or before is None:
                print(f"{name} {entry}: {before} -> {now}")
                continue
            size = f"{sum(before['bytes'])} -> {sum(now['bytes'])} bytes"
            psnr = "  ".join(f"{what} {before[what]:.3f} -> {now[what]:.3f} dB" for what in ("held_out", "training"))
            kinds = "" if before["kinds"] == now["kinds"] else f"  {before['kinds']} -> {now['kinds']}"
            print(f"{name} {entry}: {size}  {psnr}{kinds}")
    print(f"{changed} of {sum(map(len, new.values()))} entries changed" if changed else "nothing changed")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="make what is found the expectation")
    parser.add_argument("--keyframes", action="store_true", help="train the keyframes anew, with --write")
    options = parser.parse_args()
    if options.keyframes and not options.write:
        parser.error("--keyframes changes every figure; say --write, too")
    old = json.loads(EXPECTED.read_text()) if EXPECTED.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        new = all_figures(Path(folder), keyframes=options.keyframes)
    show(old, new)
    if options.write:
        EXPECTED.write_text(json.dumps(new, indent=1) + "\n")


if __name__ == "__main__":
    main()
