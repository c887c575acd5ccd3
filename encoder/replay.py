"""Goes on from what an earlier encode wrote: each of its frames is done again but for the training.

Training's result is in the frame's packet; everything else that later frames need follows from packet and pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from decogs.codec.digest import digest
from decogs.codec.frame_payload import split_payload
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import changed_between
from decogs.codec.syntax import payload_costs
from decogs.formats.container import Packet, PacketKind

from .change.detection import Change
from .coding.coded_scene import Written
from .input.imported_keyframe import KeyframeSource
from .input.imported_splats import SplatSource
from .input.ingest import RigFrame
from .input.recordings import recorded_in
from .output.resume import Interrupted
from .stopwatch import Stopwatch
from .stream_state import StreamState


@dataclass(frozen=True)
class Replayed:
    """A frame that was done again: compensated, its packet, what changed, what is not compensated any more."""

    frame: RigFrame
    written: Written
    change: Change
    uncorrected: list[str] = field(default_factory=list)


def take_over(state: StreamState, left: Interrupted, span: range) -> None:
    """Takes header, near planes and cameras' colours of what an earlier encode left of frames ``span``.

    Raises UsageError unless it is the beginning of this encode.
    """
    first, header, source = span.start, left.header, state.source
    if source is not None:
        source.check(state.ingest, first)
        header = source.header
    near = header.near_planes
    state.ingest.set_near_planes({camera.name: near.get(camera.name, 0.0) for camera in state.ingest.rig.cameras})
    state.compensation.colours = header.camera_colours
    state.recorded = recorded_in(left.header)
    state.scene = state.new_scene(first, header.lattice, header.sh_degree)
    left.check(state.scene.header, len(span))
    if source is not None:
        key = reconstruct(None, next(left.packets()), state.scene.header)
        left.check_keyframe(same=digest(key) == digest(source.state))


def splats_taken_over(source: SplatSource, left: Interrupted) -> KeyframeSource:
    """What an earlier encode made of a file's Gaussians; that it was this file, `take_over` sees by the header."""
    made = reconstruct(None, next(left.packets()), left.header)
    settings = {**left.header.settings, "keyframe": source.document}
    return KeyframeSource(source.path, replace(left.header, settings=settings), made)


def replay(state: StreamState, frame: RigFrame, packet: Packet, watch: Stopwatch) -> Replayed:
    """Takes a packet for its frame as the encode that wrote it did."""
    frame = state.compensation.matched(frame)
    corrections, body = split_payload(packet, state.scene.header.corrected)
    compensated = state.compensation.undo(frame, corrections)
    written = Written(packet, payload_costs(body, state.scene.header.coefficients))
    if not state.scene.is_open:
        state.scene.take(packet)
        state.compensation.see(state.scene.splats)
        state.compensation.begin(corrections)
        state.begin(compensated, watch)
        return Replayed(compensated, written, Change([], np.ones(len(state.scene.state), bool)))
    restarted = state.restart(packet.frame, watch)
    if _begins_anew(packet, state):
        state.forget()
        state.scene.take(packet)
        state.compensation.see(state.scene.splats)
        state.compensation.begin(corrections)
        state.start_anew(compensated, watch)
        everything = np.ones(len(state.scene.state), bool)
        return Replayed(compensated, written, Change([], everything, cut=True))
    state.return_from_flash(compensated, watch)
    now = state.detect(frame, compensated, corrections, watch, restarted=restarted)
    if now.change.cut:
        now = state.not_cut(now)
    effects = state.plan(now).effects
    state.scene.take(packet)
    # Those that a cross-fade changes are not among those that the masks select.
    changed = changed_between(now.before, state.scene.state)
    trained = np.flatnonzero(now.change.selected | changed) if effects or changed.any() else None
    # What was held is still to be done. With a time budget, a packet of nothing is all that signals it.
    held = trained is not None and state.settings.time_budget is not None and packet.kind == PacketKind.SKIP
    if held:
        trained, effects = None, ()
    if trained is not None:
        state.views.detach(trained)
    if state.rate is not None:
        state.rate.wrote(packet.kind, packet.size)
    return Replayed(compensated, written, now.change, state.commit(now, trained, effects, held=held))


def _begins_anew(packet: Packet, state: StreamState) -> bool:
    """Whether a packet is the keyframe of another scene: all its Gaussians are younger than any before."""
    if packet.kind != PacketKind.KEY:
        return False
    scene = state.scene
    ids = reconstruct(scene.state, packet, scene.header, first=scene.first).ids
    return bool(len(ids)) and int(ids[0]) >= scene.state.next_id
