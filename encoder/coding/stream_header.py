"""The header of an encode's stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from decogs.codec.header.header import StreamHeader, constant_effects
from decogs.codec.packets.corrections import CorrectedCameras, Corrections, with_lamps
from decogs.codec.packets.sound import SoundTrack
from decogs.codec.scene.lattice import Lattice
from decogs.formats.cameras import is_distorted
from decogs.formats.rigs import Rig
from decogs.rig.pictures.ingest import Ingest
from decogs.rig.pictures.recording_digests import setting_of

from ..settings.encode import EncodeSettings


def stream_header(
    ingest: Ingest,
    settings: EncodeSettings,
    *,
    first: int,
    lattice: Lattice,
    sh_degree: int,
    seed: int,
    corrected: CorrectedCameras,
    colours: Corrections,
    inherited: Mapping[str, Any] | None,
    recorded: Mapping[str, str],
    sound: tuple[SoundTrack, ...],
) -> StreamHeader:
    """The header of a stream whose first frame is the rig's ``first``.

    ``corrected``: cameras whose drift is compensated. ``colours``: how those of cameras differ from the
    scene's in every frame. ``inherited``: settings of an imported keyframe, which made it. ``recorded``: digests of the
    first frame's pictures by camera, none if the encode has none. ``sound``: the stream's tracks.
    """
    rig, document = ingest.rig, settings.as_document() | dict(inherited or {})
    pictures = setting_of(recorded, [camera.name for camera in rig.cameras])
    return StreamHeader(
        cameras=ingest.cameras,
        lattice=lattice,
        sh_degree=sh_degree,
        fps=rig.fps,
        first_frame=first,
        effects=tuple(
            dict.fromkeys((*_carried(settings, rig, sh_degree), *constant_effects(colours), *corrected.effects))
        ),
        held_out=tuple(view.camera.name for view in ingest.held_out_views),
        source_text=rig.source_text,
        licence=rig.licence,
        units=rig.length_unit or StreamHeader.units,
        settings={"seed": seed, "scale": ingest.scale, **pictures, **document},
        corrected=corrected,
        camera_colours=with_lamps(colours, settings.corrections.lamps),
        subject=ingest.background is not None,
        sound=sound,
    )


def _carried(settings: EncodeSettings, rig: Rig, sh_degree: int) -> tuple[str, ...]:
    """The effects that the stream may carry and a decoder must know (SPEC.md, "Header packet")."""
    carried = list(settings.frame_effects)
    if sh_degree:
        carried.append("view_dependence")
    if any(is_distorted(camera) for camera in rig.cameras):
        carried.append("lens_distortion")
    return tuple(carried)
