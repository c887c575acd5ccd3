"""A stream's facts as text for the terminal: the summary and the byte table of ``decogs-info``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.layer_list import Layer
from decogs.codec.header.profiles import PROFILES
from decogs.codec.packets.sound import RATE
from decogs.formats.cli.command_line import printable, size_text

from .info import FrameInfo, SoundInfo, StreamInfo


def summary_lines(facts: StreamInfo) -> Iterator[str]:
    """What ``decogs-info`` prints: the stream, its cameras, and a row for each frame."""
    header, totals = facts.header, facts.totals
    yield f"{facts.path}: {size_text(facts.file_bytes)}, bitstream {facts.version[0]}.{facts.version[1]}"
    if not facts.complete:
        tail = f", {facts.unfinished_bytes} bytes of an incomplete packet follow" if facts.unfinished_bytes else ""
        yield f"unfinished   the stream has no end packet{tail}"
    lost = f", {totals['lost_frames']} lost" if totals["lost_frames"] else ""
    yield f"frames       {totals['frames']} ({totals['key_frames']} key, {totals['delta_frames']} delta, " + (
        f"{totals['skip_frames']} skip{lost})" + ("" if header.fps is None else f" at {header.fps:g} fps")
    )
    for damage in facts.damage:
        yield f"damage       {printable(str(damage))}"
    for camera in header.cameras:
        lens = "" if camera.distortion_model == "none" else f", {camera.distortion_model} lens"
        yield f"camera       {camera.name}  {camera.width}x{camera.height}{lens}" + _coded_effects(camera.name, header)
    for name, value in header.presentation.as_document().items():
        yield f"{name.replace('_', ' '):<12} {printable(str(value))}"
    for sound in facts.sounds:
        yield f"sound        {printable(_sound(sound))}"
    for number, layer in enumerate(header.layers):
        yield f"layer        {_layer(number, layer)}"
    yield from _profiles(facts)
    if header.subject:
        yield "subject      without a background, with alpha"
    yield f"colour       SH degree {header.sh_degree}, background {','.join(f'{c:g}' for c in header.background)}"
    for name, text in (
        ("effects", ", ".join(header.effects)),
        ("source", header.source_text),
        ("licence", header.licence),
        ("writer", header.writer),
        ("settings", _short_settings(header.settings)),
    ):
        if text:
            yield f"{name:<12} {printable(text)}"
    yield ""
    yield " frame kind       bytes  Gaussians   touched   added removed   share"
    yield from (_row(frame) for frame in facts.frames)
    if any(frame.refers_to_first for frame in facts.frames):
        yield "key*: coded as the difference from the first keyframe, against which it counts"
    yield ""
    yield f"bytes per frame           {_number(totals['bytes_per_frame'])} (the whole file over all frames)"
    yield f"  without the first key   {_number(totals['bytes_per_frame_without_first_key'])}"
    yield f"  mean delta              {_number(totals['mean_delta_bytes'])}"
    yield f"  mean keyframe           {_number(totals['mean_key_bytes'])}"
    if totals["mean_touched_fraction"] is not None:
        yield f"share touched, mean       {totals['mean_touched_fraction']:.2%}"
    for purpose, count in sorted(totals["bytes_by_purpose"].items(), key=lambda item: -item[1]):
        yield f"bytes of {purpose:<22} {count:>10}  {count / max(1, facts.file_bytes):6.1%}"


def _sound(sound: SoundInfo) -> str:
    track = sound.track
    position = "" if track.position is None else f", at {','.join(f'{value:g}' for value in track.position)}"
    title = f"{track.title}: " if track.title else ""
    channels = ("mono", "stereo")[track.channels - 1]
    return f"{title}Opus, {channels}, {RATE} Hz, {sound.seconds:.2f} s, {size_text(sound.bytes)}{position}"


def _layer(number: int, layer: Layer) -> str:
    name = "base" if number == 0 else f"{number}, with those below"
    likeness = "" if layer.psnr is None else f", {layer.psnr:.1f} dB of the whole"
    size = f"{size_text(round(layer.bytes_per_frame))} a frame" if layer.bytes_per_frame else "bytes not known"
    return f"{name}: up to {layer.gaussians} Gaussians, {size}{likeness}"


def _profiles(facts: StreamInfo) -> Iterator[str]:
    """What each layer keeps within, as measured; and where the header says otherwise."""
    for number, load in enumerate(facts.loads):
        layer = f"layer {number}: " if facts.header.layers else ""
        yield f"profile      {layer}{load.profile or 'none; for desktop ' + load.excess(PROFILES['desktop'])}"
        said = facts.header.profiles[number] if facts.header.profiles else load.profile
        if said in PROFILES and (excess := load.excess(PROFILES[said])):
            yield f"NOT AS SAID  {layer}the header says {said}, but {excess}"


def _coded_effects(name: str, header: StreamHeader) -> str:
    """Corrections of a camera that frames code, beside its calibration."""
    if name in header.held_out:
        if header.colours_of(name):
            return ", held out, shown with the lens falloff that the others have"
        corrects = header.corrected.effects or header.camera_colours
        return ", held out" + (", its own drift is unknown: shown drift-free" if corrects else "")
    return "".join(f", {effect.replace('_', ' ')}" for effect in header.camera_effects(name))


def byte_lines(facts: StreamInfo) -> Iterator[str]:
    """Bytes by frame and purpose; the rows of frames and "around" add up to the last one, and that to the file."""
    table = facts.byte_table
    names = [*table.purposes, "all"]
    widths = [max(9, len(name) + 1) for name in names]

    def line(label: str, values: Sequence[float]) -> str:
        cells = [*values, sum(values)]
        return f"{label:<14}" + "".join(f"{v:>{width}.0f}" for v, width in zip(cells, widths, strict=True))

    yield f"{'bytes':<14}" + "".join(f"{name:>{width}}" for name, width in zip(names, widths, strict=True))
    for frame, row in zip(facts.frames, table.rows, strict=True):
        yield line(f"{frame.index:>6} {frame.kind}{'*' * frame.refers_to_first}", row)
    for kind, means in table.means.items():
        yield line(f"mean of {kind}", means)
    yield line("around frames", (*[0] * (len(table.purposes) - 1), table.around))
    yield line("the file", table.totals)


def _short_settings(settings: Mapping[str, Any]) -> str:
    """The settings that are single values; groups of them are for --json."""
    shown = [f"{key}={value}" for key, value in settings.items() if not isinstance(value, Mapping)]
    return ", ".join(shown) + (" (groups: see --json)" if len(shown) < len(settings) else "")


def _row(frame: FrameInfo) -> str:
    kind = frame.kind + "*" * frame.refers_to_first
    return (
        f"{frame.index:>6} {kind:<5} {frame.bytes:>10} {frame.gaussians:>10} {frame.touched:>9} "
        f"{frame.added:>7} {frame.removed:>7} {frame.touched_fraction:>7.2%}"
    )


def _number(value: float | None) -> str:
    return f"{'-':>10}" if value is None else f"{value:>10.0f}"
