"""The readable float64 twin of the native kernel: every pixel sees every Gaussian, no tiles, no SIMD.

Works on numpy arrays and, unchanged, on torch float64 tensors (the caller passes the module as ``xp``), so that the
encoder's tests get reference gradients from automatic differentiation while this layer never imports torch. Memory is
O(pixels x Gaussians): for scenes of some hundred Gaussians and pictures of some thousand pixels.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.geometry.spherical_harmonics import sh_basis

BLUR = 0.3
"""Variance of the low-pass filter, square pixels (Kerbl 2023)."""
ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.99
TRANSMITTANCE_MIN = 1e-4
CLOSEST = 0.5
"""A Gaussian nearer than this many of its largest sigma is not drawn: the linearisation means nothing there."""


def _clamp(xp: ModuleType, value: Any, low: float, high: float) -> Any:
    return xp.where(value < low, xp.full_like(value, low), xp.where(value > high, xp.full_like(value, high), value))


def render_reference(
    xp: ModuleType,
    means: Any,
    log_scales: Any,
    quaternions: Any,
    opacity_logits: Any,
    sh: Any,
    camera: Camera,
    background: Any,
    sh_degree: int,
) -> tuple[Any, Any, Any, Any]:
    """Colour (3, H, W), alpha (H, W), summed depth (H, W) and projected centres (N, 2) through a pinhole camera.

    Source: Kerbl 2023, section 4 and equation 3; the filter's compensation is Mip-Splatting's equation 9.
    """

    def constant(values: Any) -> Any:
        return xp.asarray(np.array(values, np.float64))

    rotation = constant(camera.world_to_camera[:3, :3])
    position = means @ rotation.T + constant(camera.world_to_camera[:3, 3])
    z = position[:, 2]
    ray_x, ray_y = position[:, 0] / z, position[:, 1] / z
    scales = xp.exp(log_scales)

    width, height = camera.width, camera.height
    kx = _clamp(xp, ray_x, (-0.15 * width - camera.cx) / camera.fx, (1.15 * width - camera.cx) / camera.fx)
    ky = _clamp(xp, ray_y, (-0.15 * height - camera.cy) / camera.fy, (1.15 * height - camera.cy) / camera.fy)
    zero = xp.zeros_like(z)
    jacobian = xp.stack(
        [
            xp.stack([camera.fx / z, zero, -camera.fx * kx / z], -1),
            xp.stack([zero, camera.fy / z, -camera.fy * ky / z], -1),
        ],
        -2,
    )
    m = jacobian @ rotation @ rotation_matrices(quaternions, xp) * scales[:, None, :]
    a0, b0, c0 = (m[:, 0] ** 2).sum(-1), (m[:, 0] * m[:, 1]).sum(-1), (m[:, 1] ** 2).sum(-1)
    n0 = m[:, 0, 1] * m[:, 1, 2] - m[:, 0, 2] * m[:, 1, 1]
    n1 = m[:, 0, 2] * m[:, 1, 0] - m[:, 0, 0] * m[:, 1, 2]
    n2 = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
    det0 = n0 * n0 + n1 * n1 + n2 * n2
    a, c = a0 + BLUR, c0 + BLUR
    det = det0 + BLUR * (a0 + c0) + BLUR * BLUR
    opacities = xp.sqrt(det0 / det) / (1.0 + xp.exp(-opacity_logits))

    directions = means - constant(camera_centre(camera))
    directions = directions / xp.sqrt((directions * directions).sum(-1))[:, None]
    coefficients = (sh_degree + 1) ** 2
    rgb = 0.5 + (sh_basis(xp, sh_degree, directions)[:, :, None] * sh[:, :coefficients]).sum(1)
    rgb = xp.where(rgb > 0, rgb, xp.zeros_like(rgb))

    centres = xp.stack([ray_x * camera.fx + camera.cx, ray_y * camera.fy + camera.cy], -1)
    depths, peaks, largest = z.tolist(), opacities.tolist(), [max(row) for row in scales.tolist()]
    drawn = [
        i
        for i, d in enumerate(depths)
        if d > 0 and d >= max(camera.near, CLOSEST * largest[i]) and peaks[i] > ALPHA_MIN
    ]
    px, py = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    transmittance = xp.ones_like(constant(px))
    colour = [xp.zeros_like(transmittance) for _ in range(3)]
    depth = xp.zeros_like(transmittance)
    live = constant(px) > -1
    for i in sorted(drawn, key=depths.__getitem__):  # stable: equal depths keep the order of the scene
        dx, dy = constant(px) - centres[i, 0], constant(py) - centres[i, 1]
        exponent = (0.5 * (c[i] * dx * dx + a[i] * dy * dy) - b0[i] * dx * dy) / det[i]
        unbounded = opacities[i] * xp.exp(-exponent)
        alpha = xp.where(unbounded > ALPHA_MAX, xp.full_like(unbounded, ALPHA_MAX), unbounded)
        following = transmittance * (1 - alpha)
        on = (unbounded >= ALPHA_MIN) & live
        live = live & ~(on & (following < TRANSMITTANCE_MIN))
        on = on & live
        weight = xp.where(on, alpha * transmittance, xp.zeros_like(alpha))
        colour = [colour[k] + weight * rgb[i, k] for k in range(3)]
        depth = depth + weight * z[i]
        transmittance = xp.where(on, following, transmittance)
    image = xp.stack([colour[k] + transmittance * background[k] for k in range(3)], 0)
    return image, 1 - transmittance, depth, centres
