"""The stages: backdrops, what stands and moves before them, lamps, and a ring of cameras. Metres, z up, floor at 0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from stages.ray import Array, Body, Lamp, Paint, noise, unit

FPS, CAMERAS, HELD_OUT = 30, 16, ("cam00", "cam05", "cam10")
WALL_RADIUS, SWEEP_RADIUS, HALF_ROOM = 5.5, 1.0, 5.2
GREY = (0.32, 0.32, 0.32)
WARM, COOL = np.array([1.0, 0.97, 0.92]), np.array([0.93, 0.97, 1.0])

# Backdrops


def cyclorama(points: Array) -> tuple[Array, Array]:
    """A floor that goes over into an upright cylinder by a quarter round (a `Room` of stages.ray)."""
    radius = np.maximum(np.hypot(points[0], points[1]), np.float32(1e-6))
    out, down = np.maximum(SWEEP_RADIUS - WALL_RADIUS + radius, 0), np.maximum(SWEEP_RADIUS - points[2], 0)
    bend = np.maximum(np.hypot(out, down), np.float32(1e-6))
    normals = np.stack([-out * points[0] / radius, -out * points[1] / radius, down]) / bend
    return SWEEP_RADIUS - bend, normals


def square_room(points: Array) -> tuple[Array, Array]:
    """Four walls and a floor (a `Room` of stages.ray)."""
    gaps = np.stack([HALF_ROOM - np.abs(points[0]), HALF_ROOM - np.abs(points[1]), points[2]])
    nearest = gaps.argmin(0) == np.arange(3)[:, None]
    return gaps.min(0), nearest * np.stack([-np.sign(points[0]), -np.sign(points[1]), np.ones_like(points[2])])


ROOMS = {
    cyclorama: {"wall_radius": WALL_RADIUS, "sweep_radius": SWEEP_RADIUS, "axis": (0, 0), "floor_height": 0},
    square_room: {"wall_half_width": HALF_ROOM, "axis": (0, 0), "floor_height": 0},
}


def plain(colour: Sequence[float]) -> Callable[[Array, Array], Array]:
    return lambda points, normals: np.broadcast_to(np.asarray(colour, np.float32)[:, None], points.shape)


def dance_floor(points: Array, normals: Array) -> Array:
    """Grey, but for a floor of wooden tiles."""
    tiles = Paint((0.36, 0.2, 0.1), (0.2, 0.1, 0.05), "checks", 0.4).colours(points * [[1], [1], [0]])
    return np.where(normals[2] > 0.999, tiles, np.float32(GREY[0]))


def boarded(points: Array, normals: Array) -> Array:
    """Grey, but for a floor of boards."""
    boards = Paint((0.3, 0.17, 0.09), (0.2, 0.1, 0.05), "stripes", 0.15).colours(points[[2, 0, 1]] * [[0], [1], [1]])
    return np.where(normals[2] > 0.5, boards, np.float32(GREY[0]))


def furnished(points: Array, normals: Array) -> Array:
    """Boards on the floor, papered walls with pictures; the wall towards +y is plain grey."""
    along = np.where(np.abs(normals[0]) > 0.5, points[1], points[0])
    wall = np.stack([0 * along, points[2], along])
    paper = Paint((0.45, 0.36, 0.25), (0.2, 0.27, 0.3), "stripes", 0.25, 0.3).colours(wall)
    framed = (np.abs((along + 40) % 1.6 - 0.8) < 0.5) & (np.abs(points[2] - 1.9) < 0.6)
    picture = np.stack([noise(points * 4 + shift) for shift in (0, 17, 31)]) ** 2
    painted = np.where(framed, picture, paper)
    bare = (normals[2] > 0.5) | (normals[1] < -0.5)
    return np.where(bare, boarded(points, normals), painted)


# Bodies


def ellipsoid(
    centre: Sequence[float], radii: Sequence[float], paint: Paint, turn: float = 0, moves: bool = True
) -> Body:
    """Turned about the vertical."""
    c, s = np.cos(turn), np.sin(turn)
    return _body(centre, [[c, s, 0], [-s, c, 0], [0, 0, 1]], radii, 0, paint, moves)


def capsule(start: Array, end: Array, radii: Sequence[float], paint: Paint, ahead: Array, moves: bool = True) -> Body:
    """``radii``: to the side, towards ``ahead``, and that of the ends along it."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    side = np.cross(ahead, along)
    side = side / np.linalg.norm(side)
    axes = np.stack([side, np.cross(along, side), along])
    return _body((start + end) / 2, axes, radii, length / 2 / radii[2], paint, moves)


def _body(
    centre: Sequence[float] | Array, axes: object, radii: Sequence[float], half: float, paint: Paint, moves: bool
) -> Body:
    centre, axes, radii = (np.asarray(v, np.float32) for v in (centre, axes, radii))
    return Body(centre, axes, radii, half, paint, moves)


SKIN = Paint((0.55, 0.33, 0.24), (0.4, 0.22, 0.15), grain=0.3)
DARK = Paint((0.05, 0.035, 0.03), (0.16, 0.1, 0.07))
SHIRT = Paint((0.5, 0.06, 0.05), (0.6, 0.5, 0.4), "stripes", 0.06)
JEANS = Paint((0.04, 0.08, 0.25), (0.25, 0.33, 0.5), width=0.08, grain=0.8)
JUMPER = Paint((0.5, 0.38, 0.04), (0.06, 0.12, 0.3), "checks", 0.07)
TARTAN = Paint((0.35, 0.3, 0.28), (0.1, 0.03, 0.12), "checks", 0.09)
BALL = Paint((0.6, 0.55, 0.5), (0.5, 0.05, 0.1), "checks", 0.08, 0.2)
WOOD = Paint((0.3, 0.16, 0.07), (0.14, 0.07, 0.03), width=0.04)
METAL = Paint((0.12, 0.12, 0.13), (0.3, 0.3, 0.32), width=0.3)
DULL = Paint((0.3, 0.11, 0.09), (0.3, 0.11, 0.09), grain=0.0)
UNDYED = Paint(GREY, GREY, grain=0.0)


def performer(
    place: tuple[float, float], heading: float, step: float, raised: float, top: Paint, trousers: Paint
) -> list[Body]:
    """Seventeen bodies, the lower shoe on the floor; facing ``heading``, arms ``raised`` (radians), in ``step``."""
    ahead = np.array([np.cos(heading), np.sin(heading), 0], np.float32)
    left, up = np.array([-ahead[1], ahead[0], 0], np.float32), np.array([0, 0, 1], np.float32)

    def swung(angle: float, spread: float) -> Array:
        return unit(ahead * np.sin(angle) - up * np.cos(angle) + left * spread)

    hips = np.array([*place, 0.95], np.float32)
    neck, head = hips + 0.5 * up, hips + 0.7 * up
    made = [
        capsule(hips, hips + 0.02 * left, (0.12, 0.13, 0.12), trousers, up),
        capsule(hips + 0.12 * up, hips + 0.38 * up, (0.19, 0.12, 0.12), top, ahead),
        capsule(neck - 0.05 * up, neck + 0.08 * up, (0.055, 0.055, 0.055), SKIN, ahead),
        ellipsoid(head, (0.105, 0.085, 0.13), SKIN, heading),
        ellipsoid(head + 0.035 * up - 0.025 * ahead, (0.105, 0.095, 0.12), DARK, heading),
    ]
    soles = []
    for side in (1, -1):
        swing = side * np.sin(step)
        hip, shoulder = hips + 0.09 * side * left, hips + 0.43 * up + 0.2 * side * left
        knee = hip + 0.42 * swung(0.45 * swing, 0.03 * side)
        ankle = knee + 0.42 * swung(0.45 * swing - 0.2 - 0.35 * max(0.0, side * np.cos(step)), 0)
        elbow = shoulder + 0.28 * swung(raised - 0.5 * swing, 0.25 * side)
        wrist = elbow + 0.25 * swung(raised - 0.5 * swing + 0.5 + 0.4 * raised, -0.1 * side)
        made += [
            capsule(hip, knee, (0.085, 0.085, 0.085), trousers, ahead),
            capsule(knee, ankle, (0.06, 0.06, 0.06), trousers, ahead),
            capsule(ankle - 0.04 * up, ankle - 0.04 * up + 0.14 * ahead, (0.05, 0.045, 0.05), DARK, up),
            capsule(shoulder, elbow, (0.055, 0.055, 0.055), top, left),
            capsule(elbow, wrist, (0.042, 0.042, 0.042), SKIN, left),
            ellipsoid(wrist, (0.05, 0.05, 0.05), SKIN),
        ]
        soles.append(float(ankle[2]) - 0.085)
    return [replace(body, centre=body.centre - min(soles) * up) for body in made]


def stool() -> list[Body]:
    place, up = np.array([-0.55, -0.75, 0], np.float32), np.array([0, 0, 1], np.float32)
    corners = [np.array([np.cos(a), np.sin(a), 0], np.float32) for a in (0.3, 2.4, 4.5)]
    legs = [
        capsule(place + 0.17 * c + 0.03 * up, place + 0.1 * c + 0.44 * up, (0.02, 0.02, 0.02), WOOD, c, moves=False)
        for c in corners
    ]
    return [ellipsoid(place + 0.46 * up, (0.18, 0.18, 0.035), WOOD, moves=False), *legs]


def ball(frame: int) -> Body:
    """Thrown from one performer to the other and back."""
    share = 1 - abs(1 - (0.15 + frame / FPS / 0.9) % 2)
    height = 1.1 + 4 * 0.55 * share * (1 - share)
    return ellipsoid(
        (0.1 - 0.35 * (1 - 2 * share), 0.3 * (2 * share - 1) + 0.05, height), (0.12, 0.12, 0.12), BALL, 6 * share
    )


def flying(frame: int) -> list[Body]:
    """A dull ball near the pictures' borders, which flies further in a frame than it is wide."""
    return [ellipsoid((1.36, -0.5 + 0.26 * frame, 1.95), (0.12, 0.12, 0.12), DULL)]


def nothing_more(frame: int) -> list[Body]:
    return []


def on_stage(frame: int, clothes: tuple[Paint, Paint] = (JUMPER, TARTAN)) -> list[Body]:
    """One performer walks in a circle, until frame 40 clear of one who gestures in ``clothes``; a ball, a stool."""
    time = frame / FPS
    round_ = 0.7 + 1.3 * time
    walking = performer(
        (0.5 * np.cos(round_), 0.5 * np.sin(round_)), round_ + np.pi / 2, 7 * time + 1, 0.1, SHIRT, JEANS
    )
    raised = 0.9 + 0.5 * np.sin(5 * time)
    gesturing = performer((-0.45, -0.3), 0.4 - 0.9 * time, 0.5 * np.sin(4 * time), raised, *clothes)
    return [*walking, *gesturing, ball(frame), *stool()]


def long_take(frame: int, clothes: tuple[Paint, Paint]) -> list[Body]:
    """Two performers walk round each other, now and then the other way, turn and reach; no frame is like another.

    They stay clear of each other. One carries a ball about, which the other takes over; a dull one lies between them.
    """
    time = frame / FPS
    way = 0.9 * time + 1.1 * np.sin(0.53 * time)
    apart = 0.55 + 0.1 * np.sin(0.71 * time)
    reach = 0.7 + 0.6 * np.sin(1.9 * time), 0.7 + 0.6 * np.sin(1.3 * time + 2)
    turn = 1.2 * np.sin(0.61 * time), 1.2 * np.sin(0.83 * time + 1)
    dress = ((SHIRT, JEANS), clothes)
    made, hands = [], []
    for index, sign in enumerate((1, -1)):
        place = sign * apart * np.cos(way), sign * apart * np.sin(way)
        heading = way + index * np.pi + np.pi / 2 + turn[index]
        made += performer(place, heading, 5.1 * way + index, reach[index], *dress[index])
        hands.append(made[-1].centre)  # the right hand
    share = 0.5 + 0.5 * np.clip(3 * np.sin(0.9 * time), -1, 1)
    carried = (1 - share) * hands[0] + share * hands[1] + np.array([0, 0, 0.8 * share * (1 - share)])
    made.append(ellipsoid(carried, (0.13, 0.13, 0.13), BALL, 2 * time))
    rolled = (0.16 * np.sin(1.7 * time), 0.16 * np.cos(1.1 * time), 0.12)
    return [*made, ellipsoid(rolled, (0.12, 0.12, 0.12), DULL, 3 * time), *stool()]


def rigging() -> tuple[Body, ...]:
    """Trusses and lamps before the wall, tripods of cameras between."""
    up, made = np.array([0, 0, 1], np.float32), []
    for angle in np.arange(8) * np.pi / 4 + 0.2:
        out = np.array([np.cos(angle), np.sin(angle), 0], np.float32)
        over = np.array([np.cos(angle + np.pi / 4), np.sin(angle + np.pi / 4), 0], np.float32)
        foot = 4.9 * out
        made += [capsule(foot + z * up, 4.9 * over + z * up, (0.04,) * 3, METAL, up, False) for z in (3.2, 3.55)]
        made.append(capsule(foot + 0.05 * up, foot + 3.6 * up, (0.05,) * 3, METAL, out, False))
        made.append(ellipsoid(4.6 * out + 2.95 * up, (0.16, 0.16, 0.2), METAL, angle, False))
    for camera in cameras((64, 64)):
        eye = camera_centre(camera).astype(np.float32)
        made.append(ellipsoid(eye, (0.09, 0.09, 0.07), DARK, moves=False))
        for angle in (0.5, 2.6, 4.7):
            foot = eye * [1, 1, 0] + 0.35 * np.array([np.cos(angle), np.sin(angle), 0.05])
            made.append(capsule(foot.astype(np.float32), eye - 0.1 * up, (0.018,) * 3, METAL, up, False))
    return tuple(made)


# Light and cameras


def lamps() -> list[Lamp]:
    """Four panels of a dozen points each, and a faint dome that leaves corners darker."""
    made = []
    for angle, power in ((0.6, 14.0), (2.3, 9.0), (3.9, 12.0), (5.4, 8.0)):
        place = np.array([3.0 * np.cos(angle), 3.0 * np.sin(angle), 4.3])
        aim = unit(np.array([0, 0, 1.4]) - place)
        across = unit(np.cross(aim, [0, 0, 1]))
        for spot, turn in enumerate(np.arange(12) * 2.4):
            out = 0.8 * np.sqrt((spot + 0.5) / 12) * (np.cos(turn) * across + np.sin(turn) * np.cross(aim, across))
            made.append(_lamp(place + out, aim, power / 12 * WARM))
    for spot, turn in enumerate(np.arange(20) * 2.4):
        lift = 0.3 + 0.7 * (spot + 0.5) / 20  # even on a sphere, none so low that shadows reach the wall
        way = np.array([*np.sqrt(1 - lift**2) * np.array([np.cos(turn), np.sin(turn)]), lift])
        made.append(_lamp([0, 0, 0.5] + 4.5 * way, -way, 0.9 * COOL))
    return made


def few_lamps() -> list[Lamp]:
    """A ninth of them, each as bright as nine: sharper shadows in a ninth of the time."""
    return [replace(lamp, power=9 * lamp.power) for lamp in [*LAMPS[4:48:9], *LAMPS[48::9]]]


def _lamp(place: Array, aim: Array, power: Array) -> Lamp:
    return Lamp(*(np.asarray(values, np.float32) for values in (place, aim, power)))


def cameras(size: tuple[int, int]) -> list[Camera]:
    """Sixteen all around, 4 m from the middle at three heights, aimed at (0, 0, 1); ``size``: width, height."""
    width, height = size
    random, made = np.random.default_rng(5), []
    for index in range(CAMERAS):
        angle = 2 * np.pi * (index + random.uniform(-0.1, 0.1)) / CAMERAS
        distance, lift = 4 + random.uniform(-0.15, 0.15), (1.0, 1.7, 2.5)[index % 3] + random.uniform(-0.05, 0.05)
        place = np.array([distance * np.cos(angle), distance * np.sin(angle), lift])
        forward = unit(np.array([0, 0, 1]) + random.uniform(-0.04, 0.04, 3) - place)
        right = unit(np.cross(forward, [random.uniform(-0.02, 0.02), 0, 1]))
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ place
        focal = height * 1.14 * (1 + random.uniform(-0.015, 0.015))
        made.append(Camera(f"cam{index:02d}", width, height, focal, focal, width / 2, height / 2, pose))
    return made


LAMPS = lamps()
GREY_PAINT = plain(GREY)

# Stages


@dataclass(frozen=True)
class Stage:
    """A backdrop in a room, and how it differs from the grey one. ``bounce``: what it reflects on average.

    ``acting``: the bodies of a frame, in these clothes. ``more``: further ones.
    """

    albedo: Callable[[Array, Array], Array] = GREY_PAINT
    bounce: tuple[float, float, float] = GREY
    room: Callable[[Array], tuple[Array, Array]] = cyclorama
    props: tuple[Body, ...] = ()
    clothes: tuple[Paint, Paint] = (JUMPER, TARTAN)
    gains: float = 0.0
    more: Callable[[int], list[Body]] = nothing_more
    acting: Callable[[int, tuple[Paint, Paint]], list[Body]] = on_stage
    lamps: Sequence[Lamp] = field(default_factory=lambda: LAMPS)


def _dyed(*colour: float) -> Stage:
    return Stage(plain(colour), (colour[0], colour[1], colour[2]))


STAGES = {
    "grey": Stage(),
    "green": _dyed(0.05, 0.3, 0.08),
    "white": _dyed(0.55, 0.55, 0.55),
    "black": _dyed(0.004, 0.004, 0.004),
    "wall": Stage(furnished, (0.25, 0.2, 0.15), square_room),
    "rigging": Stage(props=rigging()),
    "camouflage": Stage(clothes=(UNDYED, UNDYED)),
    "exposure": Stage(gains=0.08),
    "flying": Stage(more=flying),
    "floor": Stage(dance_floor, (0.25, 0.16, 0.1)),
    "take": Stage(acting=long_take, lamps=few_lamps()),
    "home": Stage(furnished, (0.25, 0.2, 0.15), square_room, acting=long_take, lamps=few_lamps()),
    "boards": Stage(boarded, (0.25, 0.2, 0.15), square_room),
}
