"""The branches of a recording, whatever its order, signs and strokes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recordings import press_at, release_at, stroke, strokes, text_of

from hapsim.curves.recording import Branch, Recording, recording_of
from hapsim.curves.thinning import limited, smooth, thinned
from hapsim.errors import UsageError
from hapsim.scene.curve_file import read_table

GF, ROUNDED = 9.80665e-3, 0.06  # of a force


def off(branch: Branch, of: Callable[..., np.ndarray]) -> float:
    """Largest distance of rows from a known branch, gf."""
    return float(np.abs(branch.force / GF - of(branch.x * 1e3)).max())


@pytest.mark.parametrize("number", [1, 2, 4])
def test_strokes_are_parted_where_the_motion_turns(recorded: Callable[..., Recording], number: int) -> None:
    found = recorded(*strokes(number))
    press, release = found.branches
    assert found.strokes == 2 * (number if number < 2 else number - 1)
    assert off(press, press_at) < 0.02 * 110.0  # the rest at the bottom has both
    assert off(release, release_at) < ROUNDED
    assert bool(found.notes) is (number > 1)


def test_shaking_distances_are_no_turns(recorded: Callable[..., Recording]) -> None:
    mm, force = stroke(noise=0.3)
    found = recorded(mm + np.random.default_rng(1).normal(0.0, 0.02, mm.size), force)
    assert found.strokes == 2


@pytest.mark.parametrize(("x", "y"), [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0)])
def test_pressing_takes_energy_whatever_the_signs_of_the_instrument(
    recorded: Callable[..., Recording], x: float, y: float
) -> None:
    mm, force = stroke()
    press, release = recorded(x * mm, y * force).branches
    way = x if x < 0.0 else 1.0
    # A distance that falls while one presses is mirrored; a force that pulls has the other sign.
    assert off(Branch(way * x * press.x, press.force), press_at) < 2.5
    assert off(Branch(way * x * release.x, release.force), release_at) < ROUNDED


def test_distances_far_from_zero_count_from_the_beginning(recorded: Callable[..., Recording]) -> None:
    mm, force = stroke()
    found = recorded(mm + 12.3, force)
    assert off(found.branches[1], release_at) < ROUNDED
    assert found.notes == ["Distances count from 12.3 mm of the recording."]


def test_two_columns_or_two_files_are_two_branches(tmp_path: Path) -> None:
    mm = np.linspace(0.0, 3.0, 301)
    rows = "\n".join(f"{x},{p},{r}" for x, p, r in zip(mm, press_at(mm), release_at(mm), strict=True))
    (tmp_path / "both.csv").write_text(f"mm,gf,gf\n{rows}\n")
    (tmp_path / "press.csv").write_text(text_of(mm, press_at(mm)))
    (tmp_path / "release.csv").write_text(text_of(mm[::-1], release_at(mm[::-1])))
    for names in (["both"], ["press", "release"], ["release", "press"]):
        found = recording_of([read_table(str(tmp_path / f"{name}.csv")) for name in names])
        assert off(found.branches[0], press_at) < 1e-3
        assert off(found.branches[1], release_at) < 1e-3
        assert bool(found.notes) is (names[0] == "release")


def test_what_never_turns_has_one_branch(recorded: Callable[..., Recording]) -> None:
    mm = np.linspace(0.0, 3.0, 301)
    found = recorded(mm, press_at(mm))
    assert len(found.branches) == 1
    assert found.notes == ["The recording never turns: the curve has one branch, without hysteresis."]


def test_branches_of_different_ways_are_refused(tmp_path: Path) -> None:
    mm = np.linspace(0.0, 1.0, 101)
    for name, at in (("a", 0.0), ("b", 0.8)):
        (tmp_path / f"{name}.csv").write_text(text_of(mm + at, mm))
    with pytest.raises(UsageError, match="share less than half of their distances"):
        recording_of([read_table(str(tmp_path / f"{name}.csv")) for name in "ab"])
    (tmp_path / "b.csv").write_text(text_of(mm, mm, "deg,mN·m"), encoding="utf-8")
    with pytest.raises(UsageError, match="found another motion"):
        recording_of([read_table(str(tmp_path / f"{name}.csv")) for name in "ab"])


def test_noise_is_smoothed_and_its_branches_do_not_cross(recorded: Callable[..., Recording]) -> None:
    x, (press, release) = smooth(recorded(*strokes(4, noise=1.0)).branches)
    off_press, off_release = (one / GF - of(x * 1e3) for one, of in ((press, press_at), (release, release_at)))
    inner = (x > 5e-5) & (x < 2.9e-3)
    assert max(np.sqrt(np.mean(one[inner] ** 2)) for one in (off_press, off_release)) < 0.4  # of rows with 1 gf rms
    assert (press >= release).all()


def test_a_limited_curve_is_no_steeper_pushes_no_harder_and_reaches_as_far() -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        x = np.linspace(rng.uniform(-2.0, 0.0), 2.0, 200)
        upper = np.interp(x, np.sort(rng.uniform(x[0], 2.0, 12)), rng.normal(0.0, 1.0, 12))
        both, steepest = [upper, upper - rng.uniform(0.0, 0.3, x.size)], rng.uniform(0.5, 3.0)
        wide, made = limited(x, both, steepest)
        inner = np.isin(wide, x)
        assert max((np.diff(one) / np.diff(wide)).max() for one in made) <= steepest * (1.0 + 1e-9)
        for force, one in zip(both, made, strict=True):
            assert (np.abs(one[inner]) <= np.abs(force) + 1e-12).all()
            assert np.abs(one[[0, -1]] - force[[0, -1]]).max() <= steepest * (x[1] - x[0]) + 1e-12
        assert (made[0] >= made[1] - 1e-12).all()


def test_what_is_not_too_steep_is_not_changed() -> None:
    x = np.linspace(0.0, 3.0, 301)
    wide, (made,) = limited(x, [press_at(x)], 100.0)
    np.testing.assert_array_equal(wide, x)
    np.testing.assert_allclose(made, press_at(x), atol=1e-12)


def test_a_thinned_curve_has_the_fewest_points() -> None:
    x = np.linspace(0.0, 3.0, 301)
    both = [press_at(x), release_at(x)]
    np.testing.assert_allclose(x[thinned(x, both, 1e-9, 0.0)], X_OF_CORNERS, atol=1e-12)
    for within in (0.5, 2.0, 8.0):
        chosen = thinned(x, both, within, 0.0)
        assert max(np.abs(np.interp(x, x[chosen], one[chosen]) - one).max() for one in both) <= within
        assert len(chosen) == fewest(x, both, within)


def test_a_thinned_curve_keeps_peaks_and_valleys_and_the_energy_of_a_flank() -> None:
    x = np.linspace(0.0, 4.0, 401)
    force = np.sin(2.0 * np.pi * x)
    chosen = thinned(x, [force], 0.03, 0.0)
    assert {25, 75, 125, 175, 225, 275, 325, 375} <= set(chosen)
    flank = np.linspace(0.25, 0.75, 1001)
    energy = np.trapezoid(1.0 - np.interp(flank, x[chosen], force[chosen]), flank)
    assert energy == pytest.approx(0.5, rel=0.02)


X_OF_CORNERS = [0.0, 0.6, 1.2, 1.6, 2.4, 3.0]
EXTREMES = (12, 16)  # of both, tenths of the points


def fewest(x: np.ndarray, branches: list[np.ndarray], within: float) -> int:
    """Fewest points of lines that stay within a distance, each pair tried."""

    def fits(i: int, j: int) -> bool:
        part = slice(i, j + 1)
        if any(i < one < j for one in EXTREMES):
            return False
        return all(np.abs(np.interp(x[part], x[[i, j]], one[[i, j]]) - one[part]).max() <= within for one in branches)

    x, branches = x[::10], [one[::10] for one in branches]
    needed = [1]
    for j in range(1, x.size):
        needed.append(1 + min(needed[i] for i in range(j) if fits(i, j)))
    return needed[-1]


def test_points_are_no_nearer_than_the_counts() -> None:
    x = np.linspace(0.0, 3.0, 301)
    chosen = thinned(x, [press_at(x)], 13.0, 0.5)
    assert np.diff(x[chosen]).min() >= 0.5
    with pytest.raises(UsageError, match="no curve of such points"):
        thinned(x, [press_at(x)], 0.01, 0.5)
