"""The share of first points that are false on stages made by make.py: in empty space, as mattes and rooms say.

    python tests/stages/false_points.py FOLDER...

A point is false where it lies in front of the true backdrop and beside the hull of what truly stands on the stage by
more than 2 pixels in some view. Told for the search alone, and with the plain stage that it finds.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.decoder.subject.hull import Hull, SubjectView, with_margin  # noqa: E402
from decogs.encoder.keyframe.first_points import first_points  # noqa: E402
from decogs.encoder.keyframe.large_pictures import fit_to_pictures  # noqa: E402
from decogs.encoder.settings.presets import preset  # noqa: E402
from decogs.formats.rigs import open_rig  # noqa: E402
from decogs.rig.pictures.ingest import Ingest, RigFrame  # noqa: E402
from decogs.rig.stage.stage import Stage, find_stage  # noqa: E402
from stages import scenes  # noqa: E402
from stages.make import GRID, first_met, look  # noqa: E402

CLEARANCE = 0.25
"""Metres before the backdrop from which a point is not on it: a twentieth of its distance."""


def false_points(folder: Path) -> tuple[float, float, bool]:
    """Shares of false points of the search alone and of an encode, and whether a plain stage was found."""
    ingest = Ingest(open_rig(folder))
    frame = next(iter(ingest.frames(0, 1)))
    stage = find_stage(ingest.views, frame)
    scene = scenes.STAGES[json.loads((folder / "scene.json").read_text())["name"]]
    hull = _true_hull(ingest, scene)

    def share(given: Stage | None) -> float:
        xyz = _points(ingest, frame, given)
        clearance, _ = scene.room(xyz.T.astype(np.float32))
        return float(((clearance > CLEARANCE) & ~hull.holds(xyz)).mean())

    return share(None), share(stage), stage is not None


def _points(ingest: Ingest, frame: RigFrame, stage: Stage | None) -> NDArray[np.float32]:
    most = fit_to_pictures([view.pixels for view in ingest.views], preset("standard").keyframe).first_points
    return first_points(
        [view.pinhole for view in ingest.views],
        [picture.transpose(1, 2, 0) for picture in frame.training],
        cap=most if stage is None else max(1, round(stage.hull.share * most)),
        within=None if stage is None else stage.may_show,
    ).xyz


def _true_hull(ingest: Ingest, scene: scenes.Stage) -> Hull:
    bodies, shown = [*scenes.on_stage(0, scene.clothes), *scene.props], []
    for view in ingest.views:
        _, owner = first_met(look(view.pinhole, scene), bodies)
        size = view.pinhole.height, GRID, view.pinhole.width, GRID
        subject = with_margin((owner.reshape(size) >= 0).any((1, 3)))
        shown.append(SubjectView(view.pinhole, subject))
    return Hull(shown)


def main() -> None:
    print(f"{'stage':<12} {'search alone':>12} {'encode':>8}")
    for folder in map(Path, sys.argv[1:]):
        alone, encoded, is_plain = false_points(folder)
        print(f"{folder.name:<12} {alone:>12.1%} {encoded:>8.1%}{'' if is_plain else '  no plain stage'}", flush=True)


if __name__ == "__main__":
    main()
