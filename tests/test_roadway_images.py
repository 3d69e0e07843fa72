"""The rendered roadway: points land where the pinhole model has them, light falls off, noise is as declared.

Statistical bounds are two-sided with a false-alarm rate of 1e-5 each; seeds are fixed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from roadway_scenes import SHORT, blank, dot, expected_px, painted, rendered
from scipy import stats
from scipy.spatial.transform import Rotation

from graphnav._pool import in_order
from graphnav.errors import ConfigError, GraphnavError
from graphnav.simulation import render_pairs, stereo_images, write_images
from graphnav.simulation import roadway_surfaces as on
from graphnav.simulation.exposure import Drift, develop
from graphnav.simulation.ray_caster import trace
from graphnav.simulation.roadheader_camera import StereoCamera
from graphnav.simulation.roadheader_figures import CameraSpec, Lamp, LightSpec, RoadwaySpec
from graphnav.simulation.roadway_surfaces import box

FALSE_ALARM = 1e-5
ROADWAY = SHORT.roadway
#: Body poses: straight, and turned, tilted and aside as nowhere on the way.
POSES = {
    "straight": (np.zeros(3), Rotation.identity()),
    "turned left": (np.array([-0.5, 2.0, 0.02]), Rotation.from_euler("ZXY", [16.0, 0.6, -0.5], degrees=True)),
    "turned right": (np.array([-0.3, 0.5, -0.02]), Rotation.from_euler("ZXY", [-25.0, -4.0, 6.0], degrees=True)),
}


# Geometry -----------------------------------------------------------------------------------------------------


def solid(points_n: np.ndarray) -> np.ndarray:
    """Whether points lie in rock or steel, by the figures of the roadway."""
    x, y, z = points_n.T
    far = (np.abs(x) > ROADWAY.half_width_m) | (z < ROADWAY.floor_m) | (z > ROADWAY.roof_m)
    far |= (y < ROADWAY.back_m) | (y > ROADWAY.face_m)
    along = (y - ROADWAY.back_m) % ROADWAY.arch_spacing_m
    number = (y - ROADWAY.back_m) // ROADWAY.arch_spacing_m
    depth = ROADWAY.arch_depth_m
    proud = (np.abs(x) > ROADWAY.half_width_m - depth) | (z > ROADWAY.roof_m - depth)
    return far | ((along < ROADWAY.arch_width_m) & (number >= 1) & (number <= box(ROADWAY).arches) & proud)


def test_rays_end_where_air_does() -> None:
    rng = np.random.default_rng(1)
    hit = set()
    for _ in range(2000):
        start = rng.uniform([-1.5, 0.0, -1.5], [1.5, 6.0, 3.0])
        ray = rng.standard_normal(3)
        surface, _, t = trace(tuple(box(ROADWAY)), tuple(start.tolist()), *ray.tolist())
        hit.add(surface)
        steps = np.linspace(0, 1 - 1e-9, 400) * t
        assert not solid(start + steps[:, None] * ray).any()
        assert solid((start + (t + 1e-7) * ray)[None]).all()
    assert hit == set(range(on.COUNT))


#: Surface and place on it (along, across) -> point of n.
DOTS = {
    on.LEFT: [((3.35, 1.3), (-2.0, 1.85, -0.5)), ((5.6, 2.4), (-2.0, 4.1, 0.6))],
    on.RIGHT: [((3.35, 2.2), (2.0, 1.85, 0.4)), ((5.6, 1.1), (2.0, 4.1, -0.7))],
    on.FLOOR: [((5.5, 2.3), (0.3, 4.0, -1.8)), ((6.3, 3.0), (1.0, 4.8, -1.8))],
    on.ROOF: [((7.55, 2.4), (0.4, 6.05, 3.7))],
    on.FACE: [((1.5, 1.4), (-0.5, 6.5, -0.4)), ((2.8, 3.2), (0.8, 6.5, 1.4))],
    on.ARCH_LEFT: [((5 * 0.12 + 0.06, 1.6), (-1.88, 3.56, -0.2))],
    on.ARCH_RIGHT: [((6 * 0.12 + 0.06, 2.6), (1.88, 4.56, 0.8))],
}


AXES = {on.LEFT: (1, 2), on.RIGHT: (1, 2), on.ARCH_LEFT: (1, 2), on.ARCH_RIGHT: (1, 2)}  # of n, along and across
AXES |= {on.FLOOR: (1, 0), on.ROOF: (1, 0), on.FACE: (0, 2)}


def expected_centroid(
    surface: int, point_n: np.ndarray, sigma_m: float, pos_n: np.ndarray, rot_nb: Rotation
) -> np.ndarray:
    """Where the image of a dot has its centre of gravity: on a wall seen askance, not quite where its middle is."""
    grid = np.linspace(-4, 4, 33) * sigma_m
    offsets = np.zeros((33, 33, 3))
    along, across = AXES[surface]
    offsets[..., along], offsets[..., across] = grid, grid[:, None]
    places = np.array([[expected_px(SHORT.camera, point_n + o, pos_n, rot_nb) for o in row] for row in offsets])
    (u_down, u_right), (v_down, v_right) = np.gradient(places[..., 0]), np.gradient(places[..., 2])
    weight = np.abs(u_right * v_down - u_down * v_right) * np.exp(-(offsets**2).sum(axis=-1) / 2 / sigma_m**2)
    found: np.ndarray = np.einsum("ij,ijk->k", weight, places) / weight.sum()
    return found


def centroid(ratio: np.ndarray, near_px: np.ndarray, half: int = 6) -> np.ndarray:
    """Centre of gravity (u, v) of what is brighter about a place."""
    u, v = (round(float(c)) for c in near_px)
    window = ratio[v - half : v + half + 1, u - half : u + half + 1] - 1
    rows, columns = np.mgrid[v - half : v + half + 1, u - half : u + half + 1]
    return np.array([(window * columns).sum(), (window * rows).sum()]) / window.sum()


@pytest.mark.parametrize("pose", POSES)
def test_dots_on_every_surface_land_where_they_project(pose: str) -> None:
    pos_n, rot_nb = POSES[pose]
    images, dots = blank(), []
    for surface, places in DOTS.items():
        for place, point_n in places:
            ahead = float(rot_nb.inv().apply(np.array(point_n) - pos_n)[1])
            sigma_m = 1.2 / SHORT.camera.focal_px * ahead  # 1.2 pixels
            if ahead > 1 and in_view(expected_px(SHORT.camera, np.array(point_n), pos_n, rot_nb)):
                dot(images[surface], *place, sigma_m)
                dots.append(expected_centroid(surface, np.array(point_n), sigma_m, pos_n, rot_nb))
    assert len(dots) >= 4
    for side, columns in enumerate(np.array(dots)[:, :2].T):
        lit, plain = (painted(of).light(pos_n, rot_nb, bool(side))[0] for of in (images, blank()))
        for column, row in zip(columns, np.array(dots)[:, 2], strict=True):
            found = centroid(lit / plain, np.array([column, row]))
            np.testing.assert_allclose(found, [column, row], rtol=0, atol=0.05)


def in_view(place_px: np.ndarray) -> bool:
    left, right, row = place_px
    return bool(right > 10 and left < SHORT.camera.width_px - 10 and 10 < row < SHORT.camera.height_px - 10)


def test_disparity_is_focal_length_times_baseline_over_depth() -> None:
    pos_n, rot_nb = POSES["turned left"]
    camera = SHORT.camera
    depth = rendered().light(pos_n, rot_nb)[2]
    point_n = np.array([-2.0, 4.1, 0.6])
    left, right, row = expected_px(camera, point_n, pos_n, rot_nb)
    z = depth[round(float(row)), round(float(left))]
    assert left - right == pytest.approx(camera.focal_px * 0.095 / z, abs=0.05)


def test_reduced_textures_neither_alias_nor_blur() -> None:
    small = CameraSpec(width_px=80, height_px=45)
    fine = CameraSpec(width_px=80 * 6, height_px=45 * 6)
    noise = np.random.default_rng(5)
    images = [np.clip(image + 0.15 * noise.standard_normal(image.shape), 0, 1).astype(np.float32) for image in blank()]
    albedo = {}
    for name, camera in (("small", small), ("fine", fine)):
        spec = replace(SHORT, camera=camera)
        parts = [painted(painting, spec).light(*POSES["turned left"])[0] for painting in (images, blank())]
        albedo[name] = parts[0] / parts[1] * 0.5
    mean = albedo["fine"].reshape(45, 6, 80, 6).mean(axis=(1, 3))  # what a pixel's area gives, at full resolution
    true, found = mean - 0.5, albedo["small"] - 0.5
    # One sample a pixel would have several times the contrast of the areas' means and a correlation of its inverse;
    # the tent that linear interpolation is has 2/3 of a box's contrast on white noise and a correlation of 0.84.
    assert 0.15 / true.std() > 3
    assert 0.5 < found.std() / true.std() < 1.0
    assert np.corrcoef(true.ravel(), found.ravel())[0, 1] > 0.7


# Light --------------------------------------------------------------------------------------------------------


def test_light_falls_with_the_square_of_distance_and_the_visibility() -> None:
    lamp = Lamp((0.0, 0.0, -0.01), (0.0, 0.0, 1.0), 1.0, 1e4)
    light = LightSpec(lamps=(lamp,), visibility_m=15.0, lamp_share=0.5)
    camera = painted(blank(), replace(SHORT, light=light))
    middle = []
    away = np.array([1.5, 2.5, 3.5, 4.5, 5.5])
    for z in away:
        lit, _, depth = camera.light(np.array([0.0, 6.5 - 0.3 - z, 0.0]), Rotation.identity())
        assert depth[120, 212] == pytest.approx(z)
        middle.append(lit[119:121, 211:213].mean())
    expected = 0.5 * np.exp(-3.912 / 15 * 1.5 * away) / away**2
    np.testing.assert_allclose(middle, expected, rtol=0.03)  # linear between the knots of the table


def test_images_are_dark_unevenly_lit_and_noisy() -> None:
    camera = rendered()
    for number, (_, rot_nb) in enumerate(list(POSES.values())[:2]):
        left, right = camera.pair(number, 0.2 * number, np.array([0.0, -1.0, 0.0]), rot_nb)
        for grey in (left, right):
            assert 10 < np.median(grey) < 50
            assert np.percentile(grey, 99.5) > 2.5 * np.median(grey)
            assert np.percentile(grey, 1) < 0.7 * np.median(grey)


def test_noise_is_that_of_electrons() -> None:
    mean, full, read = 400.0, 3000.0, 4.0
    shape = (240, 424)
    normal = np.random.default_rng(7).standard_normal(shape).astype(np.float32)
    grey, air, dust = np.empty(shape, np.uint8), np.zeros(shape), np.ones((32, 55), np.float32)
    develop(grey, np.full(shape, mean / full), air, dust, normal, (1.0, full, read))
    electrons = (grey / 255.0) ** 2 * full
    # A grey level is 2 full / 255^2 * grey electrons wide here; rounding adds a twelfth of its square.
    level = 2 * np.sqrt(mean * full) / 255
    variance = mean + read**2 + level**2 / 12
    count = grey.size
    assert (
        abs(electrons.mean() - mean) < stats.norm.isf(FALSE_ALARM / 2) * np.sqrt(variance / count) + level**2 / 12 / 100
    )
    low, high = stats.chi2.interval(1 - FALSE_ALARM, count)
    assert low < ((electrons - mean) ** 2).sum() / variance < high


def test_dust_drifts_with_its_declared_sigma() -> None:
    camera, light = SHORT.camera, SHORT.light
    fields = [Drift.drawn(light, camera, np.random.default_rng(seed)).at(0.0, camera)[::8, ::8] for seed in range(400)]
    draws = np.array([field.ravel() - 1 for field in fields])
    # 400 independent draws at each place; the sum of eight waves is nearly normal
    low, high = np.array(stats.chi2.interval(1 - FALSE_ALARM / draws.shape[1], 400)) / 400
    share = (draws**2).mean(axis=0) / light.drift**2
    assert (share > low).all() and (share < high).all()


# Frames and files ---------------------------------------------------------------------------------------------


def test_a_frame_does_not_depend_on_the_frames_before_it() -> None:
    poses, shorter = list(POSES.values()), replace(SHORT, roadway=RoadwaySpec(face_m=2.0))
    camera, again, other = (StereoCamera(shorter, np.random.SeedSequence(seed)) for seed in (3, 3, 4))
    there = [camera.pair(number, 0.2 * number, *pose) for number, pose in enumerate(poses)]
    back = [again.pair(number, 0.2 * number, *poses[number]) for number in (2, 0)]
    for one, two in zip((there[2], there[0]), back, strict=True):
        np.testing.assert_array_equal(one, two)
    left, right = there[0]
    assert (left != right).mean() > 0.5
    assert (camera.pair(9, 0.0, *poses[0])[0] != left).mean() > 0.5  # its noise is its own
    assert (other.pair(0, 0.0, *poses[0])[0] != left).mean() > 0.5


def test_images_do_not_depend_on_the_number_of_processes(tmp_path: Path) -> None:
    short = replace(SHORT, length_m=1.0, static_s=0.5, tail_s=0.1, rate_hz=5.0, roadway=RoadwaySpec(face_m=2.0))
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        for side in ("left", "right"):
            (folder / side).mkdir(parents=True)
        assert len(list(in_order(partial(stereo_images._render, short, 1, folder), range(5), workers, batch=3))) == 5
    names = sorted(path.relative_to(tmp_path / "1") for path in (tmp_path / "1").rglob("*.png"))
    assert len(names) == 10
    for name in names:
        one, two = (np.asarray(Image.open(tmp_path / workers / name)) for workers in ("1", "2"))
        assert one.shape == (240, 424) and one.dtype == np.uint8
        np.testing.assert_array_equal(one, two)


def test_pairs_are_rendered_only_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Counted:
        asked = 0

        def __init__(self, spec: object, seed: int) -> None:
            assert seed == 4

        def __len__(self) -> int:
            return 7

        def pair(self, frame: int) -> int:
            Counted.asked += 1
            return frame

    monkeypatch.setattr(stereo_images, "Renderer", Counted)
    pairs = render_pairs("roadheader-stereo", seed=4)
    assert next(pairs) == 0 and Counted.asked == 1
    assert list(pairs) == [1, 2, 3, 4, 5, 6]


def test_images_are_refused_where_there_are_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no images with these options"):
        write_images(tmp_path, "roadheader-stereo", 1, images=False)
    with pytest.raises(ConfigError, match="no images"):
        render_pairs("face-end-uwb")
    (tmp_path / "left").mkdir()
    with pytest.raises(GraphnavError, match="left: is there already"):
        write_images(tmp_path, "roadheader-stereo", 1)
