"""Swing of a hand on a table with pieces too stiff for the loop, against the mock in virtual time."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hapsim import predict, start
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, surely_shaken_by, warnings_about
from hapsim.running.run import run, run_in_memory
from hapsim.scene import Scene, parse_scene
from hapsim.units import LINEAR
from tests import thorough
from tests.contact_scenes import Motion

SEEDS = range(thorough.points(1, 3))
Points = list[tuple[float, float]]


def text_of(points: Points, force_limit: float = 10.0, **mock: Any) -> str:
    curve = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": [list(one) for one in points]}
    document = {
        "version": 1,
        "rate": 1000,
        "device": {"mass": 0.1, "friction": 3.0, "force_limit": force_limit, "clock": "lockstep"},
        "mock": mock,
        "modules": {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "curve": curve},
    }
    return yaml.safe_dump(document)


def scene_of(points: Points, force_limit: float = 10.0, **mock: Any) -> Scene:
    return parse_scene(text_of(points, force_limit, **mock), "curve")


def steep_in_places(seed: int) -> Points:
    """Four to eight pieces of 30 µm to 1 mm that a loop of 3 N·s/m carries, and one that it does not."""
    draw = np.random.default_rng(seed)
    count = int(draw.integers(4, 9))
    widths, slopes = 10.0 ** draw.uniform(-4.5, -3.0, count), draw.uniform(200.0, 1500.0, count)
    slopes[draw.integers(1, count - 1)] = 10.0 ** draw.uniform(3.7, 4.3)
    x, force = np.cumsum(widths) - 0.5 * widths.sum(), np.cumsum(widths * slopes)
    return list(zip(x.tolist(), (force - force.mean()).tolist(), strict=True))


def button(noise: float) -> Points:
    """A button of 2 N recorded at 480 places within 10 mm, with noise (N rms)."""
    draw = np.random.default_rng(3)
    x = np.linspace(-0.01, 0.0, 480)
    force = np.interp(-x, [0.0, 0.004, 0.006, 0.01], [0.0, 2.0, 1.0, 4.0]) + noise * draw.standard_normal(x.size)
    return list(zip(x.tolist(), (-force).tolist(), strict=True))


def swing_on_mock(points: Points, prediction: Prediction) -> float:
    """m, from end to end in the last of six seconds, the most of all that begin in the middle of an unstable piece,
    held there by a steady push, and kicked by a tenth of its width, its width and ten times as much."""
    most = 0.0
    for region in (one for one in prediction.judge.regions["hand"] if not one.is_stable):
        for kick in (0.1, 1.0, 10.0):
            away = kick * (region.piece.high - region.piece.low)
            begins, push = {"position": region.piece.place + away}, {"force": region.force}
            trace = run_in_memory(scene_of(points, initial=begins, hand=push), duration=6.0)
            counts = trace.position_counts[-1000:, 0]
            most = max(most, float(np.ptp(counts) * trace.position_scale[0]))
    return most


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_as_large_as_on_the_mock(seed: int, figures: Any) -> None:
    """Within a tenth."""
    points = steep_in_places(seed)
    prediction = predict(scene_of(points), with_margins=False)
    swing = prediction.judge.swings["hand"]
    assert swing is not None
    assert swing.least <= swing.most
    seen = swing_on_mock(points, prediction)
    figures.most("swing on the mock off by, relative", abs(seen / swing.most - 1.0))
    assert seen == pytest.approx(swing.most, rel=0.1)
    shaking = surely_shaken_by(scene_of(points))
    assert shaking is not None
    assert f"to an oscillation of {swing.sentence(LINEAR)}" in shaking.sentence(LINEAR)


@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_about_as_large_as_the_describing_function_predicts(seed: int, figures: Any) -> None:
    """The largest at which the mean slope over a sine exceeds the largest stable stiffness: within a fifth."""
    prediction = predict(scene_of(steep_in_places(seed)), with_margins=False)
    (regions,), (swing,) = prediction.judge.regions.values(), prediction.judge.swings.values()
    assert swing is not None
    most_stable = float(regions[0].felt.configuration.stable_stiffness(0.0)[1])
    sine, half = np.sin(np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)), np.geomspace(1e-6, 2e-2, 600)
    largest = 0.0
    for region in (one for one in regions if not one.is_stable):
        force = region.hand.force(region.piece.place + half[:, None] * sine)
        mean_slope = 2.0 / half * np.mean(force * sine, axis=1)
        largest = max(largest, 2.0 * half[mean_slope > most_stable].max())
    figures.most("swing by the describing function off by, relative", abs(largest / swing.most - 1.0))
    assert largest == pytest.approx(swing.most, rel=0.2)


def on_a_cap(points: Points, stiffness: float = 50000.0, quantum: float = 1e-7) -> Scene:
    """The same curve between the hand and a cap of 0.1 kg on a stiff spring."""
    document = yaml.safe_load(text_of(points, quantum=quantum))
    cap = {"type": "cell", "mass": 0.1, "stiffness": stiffness, "damping": 20.0}
    document["modules"]["curve"]["between"] = ["hand", "cap"]
    return parse_scene(yaml.safe_dump(document | {"modules": document["modules"] | {"cap": cap}}), "cap")


def swing_on_a_cap(scene: Scene, stiffness: float) -> float:
    """m, simulated from the middle of the steepest piece, as `swing_on_mock`."""
    law = scene.links["curve"].law()
    steepest = max(law.pieces, key=lambda piece: piece.slope)
    end = min(edge for edge in law.edges if edge > steepest.edge)
    middle, kicks = 0.5 * (steepest.edge + end), np.array([-10.0, -1.0, -0.1, 0.1, 1.0, 10.0]) * (end - steepest.edge)
    held = float(law.tension(middle))
    cap = np.full(kicks.size, held / stiffness)
    motion = Motion(scene, {"hand": cap + middle + kicks, "cap": cap}, held=held)
    way = []
    for _ in range(6000):
        motion.step()
        way.append(motion.now["hand"])
    return float(np.ptp(way[-1000:], axis=0).max())


@pytest.mark.parametrize("seed", SEEDS)
def test_of_a_hand_that_moves_a_mass_it_is_as_large_as_simulated(seed: int, figures: Any) -> None:
    """Within a tenth, whether the scene is taken to be in the piece that is too stiff or not."""
    stiffness = float(np.random.default_rng(seed).choice([30000.0, 50000.0, 80000.0]))
    scene = on_a_cap(steep_in_places(seed), stiffness)
    shaking = surely_shaken_by(scene)
    assert shaking is not None
    assert shaking.swing is not None
    assert shaking.swing.point == "hand"
    seen = swing_on_a_cap(scene, stiffness)
    figures.most("swing beside a mass off by, relative", abs(seen / shaking.swing.most - 1.0))
    assert seen == pytest.approx(shaking.swing.most, rel=0.1)


def test_a_resonator_that_drives_itself_swings_as_far_as_its_curve_lets_it() -> None:
    """At rest the drive gives 1 N·s/m and the damper takes half of that; beyond 0.1 m/s the drive is level. A sine of
    amplitude V gets as much as it gives where 0.5 V = 2/pi (asin r + r sqrt(1 - r²)) V, r = 0.1 / V."""
    modules = {
        "ball": {"type": "cell", "mass": 0.1, "stiffness": 400.0},
        "drive": {"type": "nonlinear", "between": ["ball", "wall"], "force_over_velocity": [[-0.1, 0.1], [0.1, -0.1]]},
        "rub": {"type": "viscoelastic", "between": ["ball", "wall"], "stiffness": 0.0, "damping": 0.5},
        "finger": {"type": "buffer", "between": ["hand", "ball"], "stiffness": 500.0, "distance": 0.01},
    }
    document = yaml.safe_load(text_of([(0.0, 0.0)]))
    document["modules"]["curve"] = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 300.0}
    scene = parse_scene(yaml.safe_dump(document | {"modules": document["modules"] | modules}), "resonator")
    shaking = surely_shaken_by(scene)
    assert shaking is not None
    assert (shaking.module, shaking.state) == ("ball", "finger is apart")
    assert shaking.swing is not None
    assert shaking.swing.point == "ball"
    ratios = np.linspace(1e-3, 1.0, 100_001)
    mean = 2.0 / np.pi * (np.arcsin(ratios) + ratios * np.sqrt(1.0 - ratios**2))
    fastest = 0.1 / ratios[np.argmin(np.abs(mean - 0.5))]
    assert shaking.swing.most == pytest.approx(2.0 * fastest / np.sqrt(400.0 / 0.1), rel=0.05)


def test_a_knob_swings_by_an_angle(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    text = text_of([(-0.1, -0.05), (-0.01, -0.02), (0.0, 0.02), (0.1, 0.05)], 0.3)
    file = tmp_path / "knob.yaml"
    file.write_text(
        text.replace("mass: 0.1", "mass: 5.0e-5\n  motion: rotary").replace("3.0", "0.002"), encoding="utf-8"
    )
    out = " ".join(hapsim("check", str(file)).out.split())
    assert "Where it is unstable, hand swings by 47.7 to 48.8 mrad and up to 0.052 N·m from end to end" in out


def test_a_wall_that_is_too_stiff_swings_as_far_as_the_force_limit_lets_it() -> None:
    """No pieces bound it but the force limit: a larger limit is a larger swing."""
    points = [(-0.1, -1000.0), (0.1, 1000.0)]
    swings = [predict(scene_of(points, limit)).judge.swings["hand"] for limit in (1.0, 10.0)]
    weak, strong = (swing for swing in swings if swing is not None)
    assert strong.most == pytest.approx(10.0 * weak.most, rel=0.01)
    assert (weak.force, strong.force) == pytest.approx((2.0, 20.0))  # from one end of the limit to the other
    assert surely_shaken_by(scene_of(points)) is not None


def test_a_stop_far_beyond_the_force_limit_is_refused() -> None:
    """The scene asks for 100 N in the middle of its region, where no kick moves the hand: that is no small swing."""
    stop = {"type": "buffer", "between": ["wall", "hand"], "stiffness": 20000.0, "damping": 2.0, "distance": -0.01}
    document = yaml.safe_load(text_of([(-1.0, -100.0), (1.0, 100.0)]))
    document["device"]["travel"] = [-0.02, 0.02]
    document["modules"]["stop"] = stop
    scene = parse_scene(yaml.safe_dump(document), "stop")
    assert predict(scene, with_margins=False).judge.swings == {"hand": None}
    assert surely_shaken_by(scene) is not None


def test_what_grows_slowly_in_many_narrow_pieces_is_not_taken_for_a_small_swing() -> None:
    """100 pieces of 1 µm, each hardly too stiff (an e-fold in 50 s) and none like the next; a count is 0.1 mm."""
    limit = float(predict(scene_of([(-1.0, -1000.0), (1.0, 1000.0)])).felt[0].configuration.stable_stiffness(0.0)[1])
    slopes = limit * (1.002 + 1e-5 * np.arange(100))
    x = np.linspace(-5e-5, 5e-5, 101)
    force = np.concatenate([[0.0], np.cumsum(slopes * np.diff(x))])
    scene = scene_of(list(zip(x.tolist(), (force - force.mean()).tolist(), strict=True)), quantum=1e-4)
    prediction = predict(scene, with_margins=False)
    assert 1.0 < prediction.spectral_radius < 1.0001
    assert prediction.judge.swings == {"hand": None}
    assert surely_shaken_by(scene) is not None


def test_with_dry_friction_no_swing_is_stated_and_the_scene_is_refused() -> None:
    document = yaml.safe_load(text_of([(-1.0, -12000.0), (1.0, 12000.0)]))
    document["modules"]["rub"] = {"type": "friction", "between": ["hand", "wall"], "force": 1.0, "stiffness": 1000.0}
    scene = parse_scene(yaml.safe_dump(document), "rub")
    assert predict(scene, with_margins=False).judge.swings == {"hand": None}
    assert surely_shaken_by(scene) is not None


predict_once = cache(predict)


class TestARecordedButton:
    COARSE = 1e-4  # m: a count

    def test_that_swings_by_less_than_a_count_may_be_armed(self) -> None:
        scene = scene_of(button(0.02), quantum=self.COARSE)
        prediction = predict_once(scene)
        swing = prediction.judge.swings["hand"]
        assert swing is not None
        assert 1e-6 < swing.most < self.COARSE
        assert swing.force < 0.02 * 10.0
        assert prediction.trembles == ("hand",)
        assert not prediction.stable
        assert surely_shaken_by(scene) is None
        assert [one for one in warnings_about(scene, prediction) if one.startswith("hand oscillates by ")]
        assert run(scene, duration=0.1).report.ticks == 100

    def test_by_finer_counts_or_below_a_weaker_limit_it_is_refused(self) -> None:
        for scene in (scene_of(button(0.02), quantum=1e-6), scene_of(button(0.02), 1.0, quantum=self.COARSE)):
            with pytest.raises(
                UsageError, match=r"to an oscillation of [0-9. to]+ µm and up to [0-9.]+ N from end to end"
            ):
                start(scene, duration=0.1, unstable=False)

    @pytest.mark.thorough
    @pytest.mark.thorough
    def test_of_which_a_hand_presses_the_cap_may_be_armed_too(self) -> None:
        scene = on_a_cap(button(0.02), quantum=self.COARSE)
        shown = predict(scene, with_margins=False)
        (swing,) = shown.judge.swings.values()
        assert swing is not None
        assert 1e-6 < swing.most < self.COARSE
        assert shown.trembles == ("hand",)
        assert not shown.stable
        assert surely_shaken_by(scene) is None
        assert surely_shaken_by(on_a_cap(button(0.02))) is not None

    def test_check_sums_its_regions_up(
        self, hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("hapsim.cli.check.predict", predict_once)  # the same for words and JSON
        file = tmp_path / "button.yaml"
        file.write_text(text_of(button(0.02), quantum=self.COARSE), encoding="utf-8")
        out = hapsim("check", str(file)).out
        assert "trembles: hand swings by less than a count" in " ".join(out.split())
        assert len(out.splitlines()) < 40
        assert ", 1 of these" not in out
        assert "479 of 481 regions are narrower than a count of the mock (100 µm): noise of the recording?" in " ".join(
            out.split()
        )
        document = json.loads(hapsim("check", str(file), "--json").out)
        assert len(document["parts"][0]["regions"]) == 481
        assert 1e-6 < document["swings"]["hand"]["most_m"] < self.COARSE


def test_across_a_jump_it_is_as_large_as_on_the_mock() -> None:
    """A piece of 0.1 µm is unstable, but the swing leaves it: its period is far longer than that of the growth."""
    points = [(0.004, 0.0), (0.0040001, 0.5), (0.03, 3.0)]
    prediction = predict(scene_of(points), with_margins=False)
    swing = prediction.judge.swings["hand"]
    assert swing is not None
    assert swing.push == pytest.approx(-0.25)
    begins, held = {"position": 0.00400005}, {"force": 0.25}
    trace = run_in_memory(scene_of(points, initial=begins, hand=held), duration=6.0)
    seen = np.ptp(trace.position_counts[-1000:, 0]) * trace.position_scale[0]
    assert swing.least * 0.9 < seen < swing.most * 1.1
    (warning,) = (one for one in warnings_about(scene_of(points), prediction) if "--unstable" in one)
    assert f"in simulation hand swings by {swing.sentence(LINEAR)}" in warning
    assert "holds it" in warning


def test_a_size_that_was_not_worked_out_is_reported_and_no_guard_is_announced() -> None:
    """Dry friction has a memory, which no simulated swing has."""
    text = yaml.safe_load(text_of([(-0.1, -1000.0), (0.1, 1000.0)]))
    text["modules"]["rub"] = {"type": "friction", "between": ["hand", "wall"], "force": 0.1, "stiffness": 100.0}
    scene = parse_scene(yaml.safe_dump(text), "rubbed")
    prediction = predict(scene, with_margins=False)
    assert prediction.judge.swings == {"hand": None}
    (warning,) = (one for one in warnings_about(scene, prediction) if "--unstable" in one)
    assert "how far was not worked out" in warning
    assert "until the energy guard" not in warning
