"""Cameras by what their pictures have in common: structure from motion, and how far it is to be believed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from ..parallel import Each
from .features import F64, Features, features_of, matched, sift_extractor
from .footage import Footage, instants_of, pictures_at
from .given import CERTAIN, Given
from .held_out import split
from .placed import MAX_ERROR, MIN_CAMERAS, Calibration, OnStep, Placed, inaccurate, normalise_scale
from .structure import Mapped, Matched, map_cameras, require_pycolmap

_INSTANTS = 8
_MIN_EXPLAINED = 0.3
"""Share of matches held out that cameras have to explain. Right ones explain .36 of `panoptic_basketball` and .9 of
`workbench`; on `stage`, with its patterned wallpaper, the best that is found explains .25, and is wrong."""
_FEATURES_ERROR = 0.7
"""Pixels that a right calibration may be off by in pictures of any size, since features are: .4 on `workbench`, .6 on
`panoptic_basketball`."""
_MAX_FOCAL_ERROR, _NAMED_FOCAL_ERROR = 0.1, 0.02
"""That a focal length may have: what is left out, and what is named (docs/calibrate.md)."""
_MOVES, _MOVES_MORE = 0.4, 2.0
"""Share of a picture that moves with its camera, at least, and times the usual share: of one that pans .5 to .8; of
`workbench_drift`, where one camera shakes by a pixel, .5, and others' .3."""
_SHIFTED = 1.0
"""Pixels of a picture 640 wide: of cameras that stand still up to .5, of one that shakes (`workbench_drift`) 3.5."""
_MIRRORED = 3.0
"""Times as many matches. Pictures that have nothing in common match by chance, some ten times, either way."""
_BOARD = "show all cameras a board (--board), or put a camera in between"
_LENS_HELP = "add cameras around it, show it a board (--board), or give its lens (--intrinsics)"


def place_by_motion(
    footage: Sequence[Footage],
    *,
    frames: int | None,
    seed: int,
    shared: bool,
    given: Given | None,
    each: Each,
    on_step: OnStep,
) -> Calibration:
    """Cameras placed by structure from motion; the mean distance of two is 1. ``shared``: of one size, of one lens.

    Raises UsageError where pictures contradict given lenses.
    """
    require_pycolmap()
    instants = instants_of(footage, frames or _INSTANTS)
    total = len(footage) + 4
    features = []
    for own in each(lambda camera: features_of(list(pictures_at(camera, instants)), sift_extractor()), footage):
        features.append(own)
        on_step(len(features), total)
    pairs = list(combinations(range(len(footage)), 2))
    pair_matches = each(lambda pair: matched(*(features[number] for number in pair)), pairs)
    matches = split(features, dict(zip(pairs, pair_matches, strict=True)))
    start = Matched([one.name for one in footage], [one.size for one in footage], features, matches, shared, given)
    ways = iter(range(len(footage) + 1, total + 1))
    mapped, calibration = believed(start, footage, seed, lambda: on_step(next(ways), total))
    if given is not None and (misfits := _misfits(given, mapped, start, footage, seed)):
        raise given.contradicted(footage, misfits)
    words = moving_cameras({one.name: own.moving for one, own in zip(footage, features, strict=True)})
    for one, own in zip(footage, features, strict=True):
        if own.shifted > _SHIFTED:
            words[one.name] = "its picture shifts in the take; give a part of the take in which it stands still"
    for number, one in enumerate(footage):
        if calibration.placed and one.name in calibration.not_connected:
            pictures = [np.ascontiguousarray(picture[:, ::-1]) for picture in pictures_at(one, instants)]
            others = [*features[:number], *features[number + 1 :]]
            if is_mirrored(features[number], features_of(pictures, sift_extractor()), others):
                words[one.name] = "fits the others when it is mirrored; turn the video left to right"
    return _explained(calibration, words)


def moving_cameras(moving: Mapping[str, float]) -> dict[str, str]:
    """A word on cameras whose whole picture moves, by the share of each that does."""
    usual = float(np.median(list(moving.values())))
    moved = [name for name, share in moving.items() if share > max(_MOVES, _MOVES_MORE * usual)]
    return dict.fromkeys(moved, "most of its picture moves, of others' does not; cameras have to stand still")


def is_mirrored(own: Features, turned: Features, others: Sequence[Features]) -> bool:
    """Whether a camera's features match others' far better from pictures that are turned left to right."""
    as_recorded, as_turned = (
        sum(len(matched(one.static(), other.static())) for other in others) for one in (own, turned)
    )
    return as_turned > _MIRRORED * as_recorded


def _explained(calibration: Calibration, words: Mapping[str, str]) -> Calibration:
    """With words on cameras, as the reasons of those that are not connected, and as doubts of others."""
    reasons = {name: words.get(name, reason) for name, reason in calibration.not_connected.items()}
    doubts = {name: word for name, word in words.items() if name not in reasons}
    return replace(calibration, not_connected=reasons, doubts={**calibration.doubts, **doubts})


def _is_consistent(mapped: Mapped) -> bool:
    return mapped.score.explained >= _MIN_EXPLAINED


def _misfits(
    given: Given, mapped: Mapped | None, start: Matched, footage: Sequence[Footage], seed: int
) -> Mapping[int, float]:
    """Focal lengths, px, by which pictures contradict those given; where these leave cameras out, of free lenses."""
    if mapped is not None and _is_consistent(mapped) and (mapped.misfits or len(mapped.cameras) == len(start.names)):
        return mapped.misfits
    free, _ = believed(replace(start, given=None), footage, seed)
    if free is None or not _is_consistent(free):
        return {}
    return {
        number: camera.fx
        for number, camera in free.cameras.items()
        if not given.fits(number, camera.fx, free.focal_errors[number] / CERTAIN)
    }


def believed(
    start: Matched, footage: Sequence[Footage], seed: int, on_step: Callable[[], None] = lambda: None
) -> tuple[Mapped | None, Calibration]:
    """A reconstruction without the cameras that are not to be believed, as if their videos were not there.

    The worst is left out and the rest placed anew. Wrong matches bend the lenses of those that share them, and no
    covariance shows it: a mirrored camera among four puts the others' focal lengths 12 to 15 % off.
    """
    left_out: dict[str, str] = {}
    while True:
        mapped = map_cameras(start, seed, on_step)
        calibration = _accept_cameras(mapped, footage)
        bad = [] if mapped is None else [k for k in mapped.cameras if footage[k].name in calibration.not_connected]
        if mapped is None or not bad or len(mapped.cameras) <= MIN_CAMERAS or not _is_consistent(mapped):
            return mapped, replace(calibration, not_connected={**calibration.not_connected, **left_out})
        worst = max(bad, key=partial(_badness, mapped, footage))
        left_out[footage[worst].name] = calibration.not_connected[footage[worst].name]
        start, on_step = start.without(worst), lambda: None


def _badness(mapped: Mapped, footage: Sequence[Footage], number: int) -> tuple[float, int]:
    """What a camera is left out for, in times the most that it may be; where that is alike, fewer points are worse."""
    focal = mapped.focal_errors.get(number, 0) / _MAX_FOCAL_ERROR
    error = _reprojection_error(mapped, number) / _max_error(footage[number])
    return max(focal, error), -mapped.model.images[number + 1].num_points3D


def _max_error(one: Footage) -> float:
    return max(MAX_ERROR * one.size[0], _FEATURES_ERROR)


def _accept_cameras(mapped: Mapped | None, footage: Sequence[Footage]) -> Calibration:
    """What of a reconstruction is to be believed."""
    names = [one.name for one in footage]
    if mapped is None:
        return Calibration((), dict.fromkeys(names, f"shares too little with other cameras; {_BOARD}"), "", "")
    if not _is_consistent(mapped):
        why = f"its matches contradict one another, as with repeated patterns; {_BOARD}"
        return Calibration((), dict.fromkeys(names, why), "", "")
    errors = {number: _reprojection_error(mapped, number) for number in sorted(mapped.cameras)}
    doubts = {
        number: f"its focal length may be off by {_percent(error)}; {_LENS_HELP}"
        for number, error in mapped.focal_errors.items()
        if error > _NAMED_FOCAL_ERROR
    }
    reasons = {}
    for number, one in enumerate(footage):
        if number not in errors:
            reasons[number] = f"shares too little with placed cameras; {_BOARD}"
        elif errors[number] > _max_error(one):
            reasons[number] = inaccurate(errors[number], _BOARD)
        elif mapped.focal_errors.get(number, 0) > _MAX_FOCAL_ERROR:
            reasons[number] = doubts[number]
    kept = [number for number in errors if number not in reasons]
    calibration = Calibration(
        tuple(Placed(mapped.cameras[number], errors[number], footage[number]) for number in kept),
        {names[number]: reason for number, reason in reasons.items()},
        mapped.way,
        "",
        {names[number]: doubts[number] for number in kept if number in doubts},
        {(names[a], names[b]): count for (a, b), count in sorted(_links(mapped).items())},
        _points(mapped),
    )
    return normalise_scale(calibration)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 1 else "any amount"


def _reprojection_error(mapped: Mapped, number: int) -> float:
    """Root mean square, px, of the points that the camera sees."""
    image = mapped.model.images[number + 1]
    squares = [
        float(((image.project_point(mapped.model.points3D[point.point3D_id].xyz) - point.xy) ** 2).sum())
        for point in image.points2D
        if point.has_point3D()
    ]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _links(mapped: Mapped) -> Counter[tuple[int, int]]:
    """How many points each two cameras share, by their numbers."""
    links: Counter[tuple[int, int]] = Counter()
    for point in mapped.model.points3D.values():
        seen = sorted({element.image_id - 1 for element in point.track.elements})
        links.update(combinations(seen, 2))
    return links


def _points(mapped: Mapped) -> F64:
    """The points (P, 3) of the reconstruction."""
    return np.array([mapped.model.points3D[number].xyz for number in sorted(mapped.model.points3D)]).reshape(-1, 3)
