"""Patches of slanted walls under uneven light: drawn functions of the place on the wall, sampled at pixels."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("cv2")

from factors import so3
from graphnav.frontends.patch_alignment import aligned, patches, smoothed
from graphnav.frontends.stereo_warp import of_slope, planes, warps
from graphnav.log import Stereo

SIZE = (424, 240)
#: Disparity at the middle of the image, and its change for each pixel: a side wall 2 m away, in a pair 0.1 m apart.
DISPARITY_PX, SLOPE = 12.0, 0.05
CAMERA = Stereo(fx_px=220.0, fy_px=220.0, cx_px=211.5, cy_px=119.5, baseline_m=0.1)


class Texture:
    """Waves of random direction, length and phase, of unit variance: known at any place, without interpolation."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        length, angle = rng.uniform(7, 25, 60), rng.uniform(0, np.pi, 60)
        self._wave = 2 * np.pi / length * np.array([np.cos(angle), np.sin(angle)])
        self._phase = rng.uniform(0, 2 * np.pi, 60)

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        total = np.zeros(u.shape)
        for (x, y), phase in zip(self._wave.T, self._phase, strict=True):
            total += np.cos(x * u + y * v + phase)
        return total / np.sqrt(len(self._phase) / 2)


def pixels() -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    return u, v


def places() -> np.ndarray:
    """Away from the border, at all fractions of a pixel."""
    rng = np.random.default_rng(5)
    return rng.uniform([60, 20], [SIZE[0] - 60, SIZE[1] - 20], (1500, 2))


def pair(texture: Texture, slope: float, brighter: float = 0.0, light: float = 0.0) -> list[np.ndarray]:
    """Left and right image of a wall, with noise of one grey level.

    Parameters
    ----------
    slope : change of disparity for each pixel to the right.
    brighter : by which the contrast grows for each pixel to the right, over and over again.
    light : by which each pixel of the right image is brighter than the one before, over and over again.
    """
    rng = np.random.default_rng(8)
    u, v = pixels()
    middle = CAMERA.cx_px
    of_right = (u + DISPARITY_PX - slope * middle) / (1 - slope)  # u_right = u - d(u), solved for u
    images = []
    for column, ramp in ((u, 0.0), (of_right, light)):
        grey = 110 + 15 * texture.at(column, v) * np.exp(brighter * ((column % 60) - 30)) + ramp * ((u % 30) - 15)
        images.append(np.clip(np.round(grey + rng.normal(size=grey.shape)), 0, 255).astype(np.uint8))
    return images


def disparity_errors(images: list[np.ndarray], slope: float, told: float) -> np.ndarray:
    left, right = (smoothed(image) for image in images)
    uv = places()
    true = DISPARITY_PX + slope * (uv[:, 0] - CAMERA.cx_px)
    warp = of_slope(np.tile([told, 0.0], (len(uv), 1)))
    found = aligned(patches(left, uv), right, uv - np.column_stack([true, 0 * true]), warp, rows_fixed=True)
    inside = ((uv[:, 0] % 60 > 10) & (uv[:, 0] % 60 < 50)) & (np.abs((uv[:, 0] - true) % 30 - 15) < 6)
    errors = uv[:, 0] - found.uv_px[:, 0] - true
    return np.asarray(errors[inside & (found.similarity > 0.8)])


def test_disparity_of_a_slanted_wall() -> None:
    """Contrast that grows to one side draws the match there, and to another disparity, unless the slant is known."""
    images = pair(Texture(1), SLOPE, brighter=0.04)
    told, not_told = (disparity_errors(images, SLOPE, slope) for slope in (SLOPE, 0.0))
    assert len(told) > 300
    assert abs(not_told.mean()) > 0.015
    assert abs(told.mean()) < 0.5 * abs(not_told.mean())  # the contrast's own growth within a patch is left
    assert told.std() < not_told.std()


def test_light_that_differs_across_a_patch() -> None:
    """A ramp of brightness as strong as the texture itself changes nothing."""
    even, uneven = (disparity_errors(pair(Texture(2), 0.0, light=light), 0.0, 0.0) for light in (0.0, 3.0))
    assert abs(uneven.mean()) < 0.005
    assert uneven.std() < 1.2 * even.std()


def test_warp_is_what_becomes_of_steps() -> None:
    """Against points of the plane themselves, in both images of the pair before and after a motion of six parts."""
    rng = np.random.default_rng(6)
    uv = places()[:20]
    slope, far = rng.uniform(-0.05, 0.05, (20, 2)), rng.uniform(5, 12, 20)
    rotation = so3.exp(rng.normal(scale=0.05, size=(20, 3)))
    pos_m = rng.normal(scale=0.2, size=(20, 3))
    found = warps(CAMERA, planes(CAMERA, uv, far, slope), rotation, pos_m)

    def seen(step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        there = far + (slope * step).sum(axis=1)
        z = CAMERA.fx_px * CAMERA.baseline_m / there
        xy = (uv + step - [CAMERA.cx_px, CAMERA.cy_px]) / CAMERA.fx_px
        point = np.einsum("nij,nj->ni", rotation, np.column_stack([xy, np.ones(20)]) * z[:, None]) + pos_m
        left = point[:, :2] / point[:, 2:] * CAMERA.fx_px + [CAMERA.cx_px, CAMERA.cy_px]
        return left, CAMERA.fx_px * CAMERA.baseline_m / point[:, 2]

    for axis in range(2):
        step = 1e-4 * np.eye(2)[axis]
        (more, nearer), (less, farther) = seen(step), seen(-step)
        along = (more - less) / 2e-4
        np.testing.assert_allclose(found.left[:, :, axis], along, atol=1e-6)
        along[:, 0] -= (nearer - farther) / 2e-4
        np.testing.assert_allclose(found.right[:, :, axis], along, atol=1e-6)
    np.testing.assert_allclose(found.disparity_px, seen(np.zeros(2))[1])


def test_patch_under_a_warp() -> None:
    """Sheared, and twice as long along as across: found without bias under its warp."""
    texture, rng = Texture(3), np.random.default_rng(9)
    warp = np.array([[1.2, 0.15], [-0.1, 0.9]])
    u, v = pixels()
    first = smoothed(np.round(110 + 20 * texture.at(u, v) + rng.normal(size=u.shape)).astype(np.uint8))
    middle = np.array([CAMERA.cx_px, CAMERA.cy_px])
    back = np.linalg.inv(warp) @ (np.stack([u.ravel(), v.ravel()]) - middle[:, None]) + middle[:, None]
    grey = 110 + 20 * texture.at(*back).reshape(u.shape) + rng.normal(size=u.shape)
    uv = places()
    now = (uv - middle) @ warp.T + middle
    inside = (now > 15).all(axis=1) & (now < np.array(SIZE) - 15).all(axis=1)
    uv, now = uv[inside], now[inside]
    image = smoothed(np.round(grey).astype(np.uint8))
    found = aligned(patches(first, uv), image, now + 0.3, np.tile(warp, (len(uv), 1, 1)))
    errors = found.uv_px - now
    assert np.abs(errors.mean(axis=0)).max() < 0.005
    assert errors.std() < 0.05
