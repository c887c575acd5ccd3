"""Scenes that try the rasteriser, the textbook calculation that says where float32 may fall on either side of a
threshold, and the comparator. Loaded by path from the decoder's and the encoder's tests.

Run as a script (``python rasterise_cases.py decoder|encoder THREADS``) it prints a digest of everything the native
kernel computes on these scenes: what must not depend on the number of threads or the instruction set.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from decogs.decoder.rasterise.reference import (
    ALPHA_MAX,
    ALPHA_MIN,
    BLUR,
    CLOSEST,
    TRANSMITTANCE_MIN,
    render_reference,
)
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.geometry.spherical_harmonics import sh_basis
from decogs.formats.splats import Splats, join_splats, take_splats

ROUNDING = 2.0**-24
"""Relative error of one float32 operation."""
BAND = 1e-4
"""Alphas and transmittances this close to a threshold, relatively, may fall on its other side in float32. An alpha
carries some hundred roundings (6e-6), a transmittance after an alpha of 0.99 a hundredfold of its own (1e-5)."""


@dataclass(frozen=True)
class Case:
    """One scene through one camera; ``roundings``: how many of them the result may be off by."""

    splats: Splats
    camera: Camera
    background: tuple[float, float, float] = (0.2, 0.5, 0.7)
    roundings: int = 50


def pinhole(
    width: int,
    height: int,
    focal: float,
    *,
    turn: float = 0.0,
    nod: float = 0.0,
    offset: tuple[float, ...] = (0, 0, 2.5),
) -> Camera:
    """Camera whose principal point and focal lengths are deliberately a little odd, turned about y and then x."""
    c, s, d, e = np.cos(turn), np.sin(turn), np.cos(nod), np.sin(nod)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, d, -e], [0, e, d]]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    pose[:3, 3] = offset
    return Camera("case", width, height, focal, 1.05 * focal, width / 2 - 0.5, height / 2 + 0.7, pose)


def scene(
    seed: int,
    count: int,
    degree: int,
    *,
    spread: float = 1.0,
    sigma: tuple[float, float] = (0.03, 0.3),
    logits: tuple[float, float] = (-4.0, 4.0),
    colour: float = 0.3,
) -> Splats:
    """Random Gaussians in a box of half size ``spread`` around the origin."""
    rng = np.random.default_rng(seed)
    values = (
        rng.uniform(-spread, spread, (count, 3)),
        np.log(rng.uniform(*sigma, (count, 3))),
        rng.normal(size=(count, 4)) * rng.uniform(0.2, 3.0, (count, 1)),
        rng.uniform(*logits, count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)) * colour,
    )
    return Splats(*(np.ascontiguousarray(v, np.float32) for v in values))


def edited(splats: Splats, **arrays: Any) -> Splats:
    kept = {k: getattr(splats, k) for k in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}
    return Splats(**{k: np.ascontiguousarray(v, np.float32) for k, v in (kept | arrays).items()})


def _needles() -> Case:
    """Lengths 1000 : 1, the thin directions far below a pixel, lying in and pointing out of the picture."""
    splats = scene(11, 40, 1, logits=(2.0, 6.0))
    long = np.log(np.random.default_rng(12).uniform(0.3, 0.8, 40))
    scales = np.stack([long, long - np.log(1000.0), np.full(40, np.log(0.05))], -1)
    scales[::2, 2] = scales[::2, 1]
    return Case(edited(splats, log_scales=scales), pinhole(45, 37, 40.0, turn=0.4), roundings=200)


def _around() -> Case:
    """All round the camera: behind it, too near it, and far outside its widened field of view yet reaching into it."""
    return Case(scene(21, 150, 1, spread=4.0, sigma=(0.2, 0.9)), pinhole(45, 37, 40.0, turn=0.2, nod=-0.3))


def _stack() -> Case:
    """Layers that cover the whole picture; some are clamped at 0.99, every pixel is finished early."""
    splats = scene(31, 60, 0, sigma=(0.8, 1.2), logits=(0.5, 2.5))
    rng = np.random.default_rng(32)
    means = rng.normal(size=(60, 3)) * (0.1, 0.1, 0.0) + np.linspace(-0.5, 1.5, 60)[:, None] * (0, 0, 1)
    logits = splats.opacity_logits.copy()
    logits[::5] = 7.0
    return Case(edited(splats, means=means, opacity_logits=logits), pinhole(33, 29, 40.0), roundings=100)


def _crowd() -> Case:
    """One tile that draws more Gaussians than one batch of the kernel holds, and is finished before the last."""
    splats = scene(41, 900, 0, spread=0.5, sigma=(0.03, 0.3), logits=(-4.0, -1.5))
    means = splats.means.copy()
    means[:, 2] = np.random.default_rng(42).permutation(900) / 1024 - 0.5  # no two depths within rounding
    return Case(edited(splats, means=means), pinhole(16, 16, 26.0), roundings=100)


def _edges() -> Case:
    """Centres exactly on the borders of tiles, blocks and picture, and on pixel centres."""
    camera = Camera("edges", 33, 17, 16.0, 16.0, 16.0, 8.0, np.eye(4))
    u, v = (x.ravel() for x in np.meshgrid([0.0, 15.5, 16.0, 20.0, 32.0, 33.0], [0.0, 4.0, 16.0, 16.5, 17.0]))
    z = 1.0 + np.arange(len(u)) / 64
    means = np.stack([(u - 16.0) / 16.0 * z, (v - 8.0) / 16.0 * z, z], -1)
    return Case(edited(scene(51, len(u), 0, sigma=(0.01, 0.1), logits=(0.0, 5.0)), means=means), camera)


def _clones() -> Case:
    """Pairs at equal depth, as densification makes them: the order of the scene decides which is in front."""
    splats = scene(61, 30, 1, logits=(0.0, 3.0))
    copies = scene(62, 30, 1, logits=(0.0, 3.0))
    return Case(join_splats(splats, edited(copies, means=splats.means)), pinhole(31, 23, 30.0))


def _far() -> Case:
    """Seen from 1.7e6 units off the world's origin: positions are whole sixteenths there."""
    splats, camera = scene(63, 40, 1), pinhole(45, 37, 40.0, turn=0.3)
    shift = np.array([1e6, -1e6, 1e6])
    pose = camera.world_to_camera.copy()
    pose[:3, 3] -= pose[:3, :3] @ shift
    return Case(edited(splats, means=splats.means + shift), replace(camera, world_to_camera=pose))


def _stretched() -> Case:
    """Quaternions of any length that a float32 can tell."""
    splats = scene(64, 60, 1)
    unit = splats.quaternions / np.linalg.norm(splats.quaternions.astype(float), axis=1, keepdims=True)
    return Case(edited(splats, quaternions=unit * np.geomspace(1e-15, 1e37, 60)[:, None]), pinhole(45, 37, 40.0))


CASES: dict[str, Callable[[], Case]] = {
    "degree-0": lambda: Case(scene(1, 60, 0), pinhole(45, 37, 40.0, turn=0.3)),
    "degree-1": lambda: Case(scene(2, 60, 1), pinhole(45, 37, 40.0, turn=-0.8, nod=0.2)),
    "degree-2": lambda: Case(scene(3, 60, 2), pinhole(37, 45, 40.0, turn=2.5, offset=(0.3, -0.2, 2.8))),
    "degree-3": lambda: Case(scene(4, 60, 3), pinhole(45, 37, 40.0, nod=1.2)),
    "black": lambda: Case(scene(9, 60, 3), pinhole(45, 37, 40.0), background=(0.0, 0.0, 0.0)),
    "clamped-colours": lambda: Case(scene(6, 60, 2, colour=1.2), pinhole(45, 37, 40.0), roundings=100),
    "near": lambda: Case(scene(10, 60, 1), replace(pinhole(45, 37, 40.0), near=2.25)),
    "one-pixel": lambda: Case(scene(7, 20, 0), pinhole(1, 1, 2.0)),
    "17x13": lambda: Case(scene(8, 40, 1), pinhole(17, 13, 15.0)),
    "tiles": lambda: Case(scene(81, 220, 0, sigma=(0.01, 0.2)), pinhole(75, 67, 75.0)),
    "needles": _needles,
    "around": _around,
    "stack": _stack,
    "crowd": _crowd,
    "edges": _edges,
    "clones": _clones,
    "far": _far,
    "stretched": _stretched,
}


@dataclass(frozen=True)
class Textbook:
    """What plain matrix algebra makes of a case, in float64: rgb (3, H, W), alpha and depth (H, W), the weight of every
    Gaussian in every pixel (N, H, W), pixels whose thresholds float32 cannot decide (H, W), and reasons why the case
    as a whole could not be decided in float32."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    weights: np.ndarray
    doubtful: np.ndarray
    fragile: list[str]
    clamped: int
    finished: int


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, another road than the twin's."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    w, v = unit[:, 0, None, None], unit[:, 1:]
    cross = np.cross(np.eye(3)[None], v[:, None, :]).transpose(0, 1, 2)
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def textbook(case: Case) -> Textbook:
    """The picture from covariance matrices, their inverses and a front-to-back sum. Source: Kerbl 2023, section 4."""
    s, cam = case.splats, case.camera
    means, scales = s.means.astype(float), np.exp(s.log_scales.astype(float))
    world, shift = cam.world_to_camera[:3, :3], cam.world_to_camera[:3, 3]
    position = means @ world.T + shift
    z = position[:, 2]
    rays = position[:, :2] / z[:, None]
    size, focal, centre = np.array([cam.width, cam.height]), np.array([cam.fx, cam.fy]), np.array([cam.cx, cam.cy])
    bounds = np.stack([(-0.15 * size - centre) / focal, (1.15 * size - centre) / focal])
    held = np.clip(rays, *bounds)
    projected = rays * focal + centre
    axes = rotations(s.quaternions.astype(float)) * scales[:, None, :]
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = focal[0] / z, focal[1] / z
    jacobian[:, :, 2] = -held * focal / z[:, None]
    half = jacobian @ world @ axes
    plain = half @ half.transpose(0, 2, 1)
    filtered = plain + BLUR * np.eye(2)
    conic = np.linalg.inv(filtered)
    opacities = np.sqrt(np.linalg.det(plain) / np.linalg.det(filtered)) / (1 + np.exp(-s.opacity_logits.astype(float)))
    directions = means - camera_centre(cam)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    unclamped = 0.5 + np.einsum("nk,nkc->nc", sh_basis(np, s.sh_degree, directions), s.sh.astype(float))
    rgb = np.maximum(unclamped, 0)

    near = z / np.maximum(cam.near, CLOSEST * scales.max(1))
    drawn = np.flatnonzero((z > 0) & (near >= 1) & (opacities > ALPHA_MIN * (1 - BAND)))  # or might be
    order = drawn[np.argsort(z[drawn], kind="stable")]
    fragile = []
    if (np.abs(near - 1) < BAND).any():
        fragile.append("a Gaussian as near as a drawn one may be")
    gaps = np.diff(z[order])
    if ((gaps > 0) & (gaps < 1e-6 * z[order][1:])).any():
        fragile.append("two depths float32 cannot tell apart")
    if (np.abs(unclamped[drawn]) < 1e-5).any():
        fragile.append("a colour at the edge of black")
    if (np.abs(rays[drawn, None] - bounds).min() if len(drawn) else 1) < 1e-6:
        fragile.append("a ray at the edge of the widened field of view")

    px = np.stack(np.meshgrid(np.arange(cam.width) + 0.5, np.arange(cam.height) + 0.5), -1)
    transmittance, live = np.ones(px.shape[:2]), np.ones(px.shape[:2], bool)
    doubtful = ~live
    weights = np.zeros((len(z), *px.shape[:2]))
    clamped = 0
    for i in order:
        offset = px - projected[i]
        unbounded = opacities[i] * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", offset, conic[i], offset))
        alpha = np.minimum(unbounded, ALPHA_MAX)
        following = transmittance * (1 - alpha)
        on = live & (unbounded >= ALPHA_MIN)
        doubtful |= live & (np.abs(unbounded / ALPHA_MIN - 1) < BAND)
        doubtful |= on & (np.abs(unbounded / ALPHA_MAX - 1) < BAND)
        doubtful |= on & (np.abs(following / TRANSMITTANCE_MIN - 1) < BAND)
        live &= ~(on & (following < TRANSMITTANCE_MIN))
        on &= live
        clamped += int((on & (unbounded > ALPHA_MAX)).sum())
        weights[i] = np.where(on, alpha * transmittance, 0)
        transmittance = np.where(on, following, transmittance)
    image = np.einsum("nhw,nc->chw", weights, rgb) + transmittance * np.array(case.background)[:, None, None]
    depth = np.einsum("nhw,n->hw", weights, z)
    return Textbook(image, 1 - transmittance, depth, weights, doubtful, fragile, clamped, int((~live).sum()))


def twin(case: Case, xp: Any = np, arrays: Any = None) -> tuple[Any, Any, Any, Any]:
    """The float64 twin's rgb, alpha, depth and centres of a case."""
    s = case.splats
    arrays = arrays or [a.astype(float) for a in (s.means, s.log_scales, s.quaternions, s.opacity_logits, s.sh)]
    return render_reference(xp, *arrays, case.camera, case.background, s.sh_degree)


def compare(
    actual: np.ndarray,
    expected: np.ndarray,
    tolerance: float,
    *,
    except_at: np.ndarray | None = None,
    most_excepted: float = 0.02,
) -> None:
    """Raises AssertionError unless ``actual`` is finite and within ``tolerance`` of ``expected`` everywhere but at the
    pixels ``except_at`` (H, W), of which there may be ``most_excepted`` of all (and always one)."""
    assert actual.shape == expected.shape, f"shape {actual.shape}, expected {expected.shape}"
    assert np.isfinite(actual).all(), "not finite"
    error = np.abs(actual.astype(float) - expected)
    if except_at is not None:
        allowed = max(1.0, most_excepted * except_at.size)
        assert except_at.sum() <= allowed, f"{except_at.sum()} of {except_at.size} pixels excepted"
        error = np.where(except_at, 0.0, error)
    if error.size:
        worst = np.unravel_index(int(error.argmax()), error.shape)
        assert error[worst] <= tolerance, f"off by {error[worst]:.3g} > {tolerance:.3g} at {tuple(map(int, worst))}"


def picture_tolerance(case: Case, largest: float) -> float:
    """A pixel is a convex combination of values up to ``largest``; each weight is off by ``roundings`` roundings."""
    return case.roundings * ROUNDING * max(1.0, largest)


def cotangents(case: Case, doubtful: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random gradients of a loss by rgb (3, H, W), alpha and depth (H, W), zero where ``doubtful``."""
    rng = np.random.default_rng(99)
    size = (case.camera.height, case.camera.width)
    planes = [rng.normal(size=shape).astype(np.float32) for shape in ((3, *size), size, size)]
    if doubtful is not None:
        planes = [np.where(doubtful, np.float32(0), plane) for plane in planes]
    return planes[0], planes[1], planes[2]


def large_case() -> Case:
    """Enough Gaussians and tiles that every thread has something to do."""
    return Case(scene(71, 5000, 3, sigma=(0.005, 0.1)), pinhole(150, 101, 130.0, turn=0.5))


def decoder_digest(threads: int) -> str:
    """Hash of image, alpha and depth of every case."""
    from decogs.decoder.rasterise import render

    digest = hashlib.sha256()
    for case in [make() for make in CASES.values()] + [large_case()]:
        rendering = render(case.splats, case.camera, case.background, threads=threads)
        for plane in (rendering.image, rendering.alpha, rendering.depth):
            digest.update(plane.tobytes())
    return digest.hexdigest()


def encoder_digest(threads: int) -> str:
    """Hash of pictures, all gradients, weights, centres, loss and Adam steps of every case."""
    from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
    from decogs.encoder.backends.cpu.fixed_view import CpuFixedView

    kernel = CpuKernel(threads)
    digest = hashlib.sha256()
    for case in [make() for make in CASES.values()] + [large_case()]:
        splats = case.splats
        picture = kernel.forward(splats, case.camera, case.background, depth=True)
        v_rgb, v_alpha, v_depth = cotangents(case)
        g = kernel.backward(splats, v_rgb, v_alpha=v_alpha, v_depth=v_depth)
        view, third = CpuFixedView(kernel, case.camera), np.arange(0, len(splats), 3)
        view.set_scene(splats)
        digest.update(view.redraw(v_depth > 0).tobytes())
        view.detach(third)
        view.draw(take_splats(splats, third), third)
        digest.update(view.rgb.tobytes())
        for some in (g, view.backward(v_rgb)):
            for array in (some.means, some.log_scales, some.quaternions, some.opacity_logits, some.sh, some.view):
                digest.update(array.tobytes())
        target, focus = np.abs(v_rgb) / 3, (v_alpha > 0).astype(np.float32)
        value, gradient = kernel.loss(
            picture.rgb, target, l1_scale=0.8, ssim_scale=0.2, l1_weight=np.abs(v_depth), focus=focus
        )
        moments = np.zeros_like(g.sh), np.abs(g.sh)
        sh = splats.sh.copy()
        kernel.adam(sh, g.sh, *moments, rate=0.01, step=3)
        assert picture.depth is not None
        arrays = (
            picture.rgb,
            picture.alpha,
            picture.depth,
            gradient,
            sh,
            *moments,
        )
        for array in (*arrays, *kernel.centres(len(splats)), np.array([value.total])):
            digest.update(array.tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    print({"decoder": decoder_digest, "encoder": encoder_digest}[sys.argv[1]](int(sys.argv[2])))
