"""The enhancement's benchmark and page on drawn images: known motions are known, figures are those measured."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from dusty_scenes import headlight, seen, texture

from benchmarks import _dark_images as dark
from benchmarks import enhancement as benchmark
from benchmarks._dark_images import NOISES, Noise, pairs
from benchmarks._image_rows import Judged, Quality, Results, all_rows
from benchmarks._rendered_roadway import scenes
from benchmarks._report import Before
from benchmarks.papers import _enhancement_text as text
from benchmarks.papers._enhancement_page import write
from graphnav.frontends._opencv import Image
from graphnav.frontends.enhancement import clahe
from graphnav.frontends.image_quality import matched

QUIET = Noise(0.3, 0.0)


def drawn(count: int) -> list[tuple[str, Image]]:
    """Dark, larger than the paper's size and of another shape, as photographs are."""
    shape = (400, 500)
    light = headlight(shape, 80.0, 15.0)
    return [(f"image {k}", seen(light * texture(k, shape))) for k in range(count)]


@pytest.fixture(scope="module")
def measured() -> tuple[Results, list[str]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "photographs", lambda name: drawn(2) if name == "DICM" else [])
        patch.setattr(benchmark, "NOISES", {"usual noise": NOISES["usual noise"]})
        return benchmark.measure(1, scenes=1)


# Known motions ----------------------------------------------------------------------------------------------


def test_the_warp_of_a_pair_is_the_motion_between_its_frames() -> None:
    """All features of a nearly noiseless pair agree with it to half a pixel."""
    for pair in pairs(drawn(2), QUIET, 0):
        found = matched(pair.first, pair.second, motion="homography")
        assert found.count > 100
        assert found.true_to(pair.warp, reach_px=0.5)[found.kept].mean() > 0.95
        assert found.true_to(np.eye(3))[found.kept].mean() < 0.5  # and there is a motion


def test_pairs_are_drawn_from_seeds() -> None:
    first, again, other = (next(pairs(drawn(1), NOISES["usual noise"], seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.second, again.second)
    assert not np.allclose(first.warp, other.warp)


def test_noise_has_the_variance_that_is_stated() -> None:
    generator = np.random.default_rng(0)
    for level in (20.0, 120.0):
        frame = Noise(3.0, 0.2).added(np.full((400, 500), level), generator)
        assert frame.var() == pytest.approx(9.0 + 0.2 * level + 1 / 12, rel=0.02)  # 200,000 pixels: 1 sigma is 0.3 %


def test_the_motion_of_the_rendered_roadway_is_known() -> None:
    """Turned, shifted and of the right depth; with another depth or none of the motion it is not."""
    (scene,) = scenes(1)
    found = matched(clahe(scene.first), clahe(scene.second), "sift-faint")
    assert found.count > 100
    assert scene.confirmed(found)[found.kept].mean() > 0.9
    for wrong in ({"depth_m": 0.4 * scene.depth_m}, {"turn": scene.turn.T}, {"shift_m": -scene.shift_m}):
        assert dataclasses.replace(scene, **wrong).confirmed(found)[found.kept].mean() < 0.8


# Rows and page ----------------------------------------------------------------------------------------------


def test_rows_are_the_means_of_what_was_measured(measured: tuple[Results, list[str]]) -> None:
    results, missing = measured
    rows = {one.name: one for one in all_rows(results, missing)}
    scores = [one.scores for one in results.of("DICM", "usual noise")]
    kept = rows["DICM, usual noise, sift: matched features, enhanced"]
    assert kept.value == np.mean([s["enhanced", "sift"].kept for s in scores])
    assert kept.peer == np.mean([s["raw", "sift"].kept for s in scores])
    assert kept.target == ">= 1.2 x peer" and kept.met == (kept.value >= 1.2 * kept.peer)
    assert rows["milliseconds a frame, enhanced"].target == "<= 4 ms"
    assert rows["LIME, orb: matched features, enhanced"].met is False  # not at hand
    assert rows["rendered roadway, usual noise, orb: share of the depths with a true match, raw"].value is not None


def test_true_matches_are_among_those_kept(measured: tuple[Results, list[str]]) -> None:
    for one in measured[0].judged:
        assert {variant for variant, _ in one.scores} == {*dark.VARIANTS, "raw, faint"}
        for score in one.scores.values():
            assert 0 <= score.true <= score.kept and len(score.true_px) == score.true


def test_where_an_enhancement_loses_is_counted() -> None:
    def judged(name: str, raw: int, own: int) -> Judged:
        cases = {("raw", "sift"): raw, ("enhanced", "sift"): own}
        scores = {case: dark.Score(n + 1, n, 0.0, np.empty((n, 2))) for case, n in cases.items()}
        return Judged("A", "n", name, scores, {}, {})

    results = Results((judged("a", 10, 30), judged("b", 20, 10), judged("c", 0, 5)), {})
    assert results.lost("A", "n", "sift", "enhanced", "raw") == 1
    assert results.ratio("A", "n", "sift", "enhanced") == 3.0  # of 3, 0.5 and 5
    assert results.wrong("A", "n", "raw", "sift") == pytest.approx(3 / 33)
    assert results.mean("A", "n", "enhanced", "sift", "true") == 15.0
    assert results.quality("A", "raw", "entropy") is None


def test_page_has_the_figures_and_its_pictures(measured: tuple[Results, list[str]], tmp_path: Path) -> None:
    page = tmp_path / "enhancement.md"
    write(page, measured[0], 1, Before.now())
    written = page.read_text(encoding="utf-8")
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", written):
        assert (tmp_path / picture).stat().st_size > 1000
    raw = measured[0].mean("DICM", "usual noise", "raw", "orb", "true")
    assert f"| DICM, ORB | {raw:.0f} |" in written
    rendered = [measured[0].mean("rendered roadway", "usual noise", "raw", kind, "true") for kind in dark.KINDS]
    flat = [measured[0].mean("rendered roadway", "usual noise", "R alone", kind, "true") for kind in dark.KINDS]
    shares = " / ".join(f"{own / max(raw, 1e-9):.2f}" for own, raw in zip(flat, rendered, strict=True))
    assert f"R alone has {shares} times those of raw" in " ".join(written.split())
    assert "LIME, SIFT" not in written and "```python\nfrom graphnav.frontends.enhancement import" in written
    assert all(len(line) <= 120 or line.startswith(("|", "!")) for line in written.splitlines())


def test_page_without_niqe_says_so(measured: tuple[Results, list[str]]) -> None:
    def without(one: Judged) -> Judged:
        quality: dict[str, Quality] = {k: dataclasses.replace(v, niqe=None) for k, v in one.quality.items()}
        return dataclasses.replace(one, quality=quality)

    results = dataclasses.replace(measured[0], judged=tuple(map(without, measured[0].judged)))
    assert results.quality("DICM", "raw", "niqe") is None
    assert "NIQE was not measured" in text.why_quality(results)
