"""Several hands' stiffness, damping and mass, from the scene and from each other: measured on the mock and
predicted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import yaml

from hapsim import load_scene, predict
from hapsim.errors import UsageError
from hapsim.measuring.measure_hands import HandsMeasurement, _hand_modes, _Modes, measure_hands
from hapsim.prediction import Part
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene
from tests import thorough

SEEDS = range(thorough.points(1, 3))
Hapsim = Callable[..., Any]


def link(first: str, second: str, stiffness: float, damping: float) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping}


TIED = {"tie": link("hand_0", "hand_1", 2000.0, 5.0)}
HOLD = {"hold": link("hand_1", "wall", 500.0, 2.0)}


def text_of(modules: dict[str, Any], hands: int = 2, **more: Any) -> str:
    points = {f"hand_{channel}": {"type": "device", "channel": channel} for channel in range(hands)}
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | more.pop("device", {})
    document = {
        "version": 1,
        "rate": 1000,
        "device": device,
        "modules": points | {"wall": {"type": "ground"}} | modules,
    }
    return yaml.safe_dump(document | more, sort_keys=False)


def scene_of(modules: dict[str, Any], hands: int = 2, **more: Any) -> Scene:
    return parse_scene(text_of(modules, hands, **more), "scene")


def random_scene(rng: np.random.Generator) -> Scene:
    """Two or three hands and up to three light masses, each tied to an earlier point, some to a wall."""
    hands, masses = int(rng.integers(2, 4)), int(rng.integers(0, 4))
    names = [f"hand_{i}" for i in range(hands)] + [f"mass_{i}" for i in range(masses)]
    modules: dict[str, Any] = {
        name: {"type": "mass", "mass": float(10.0 ** rng.uniform(-2.5, -1.3))} for name in names[hands:]
    }
    ends = [(names[int(rng.integers(0, i))], names[i]) for i in range(1, len(names))]
    ends += [(names[int(rng.integers(0, len(names)))], "wall") for _ in range(int(rng.integers(0, 3)))]
    for i, pair in enumerate(ends):
        stiffness, damping = 10.0 ** rng.uniform(2.0, 3.5), 10.0 ** rng.uniform(-0.5, 0.8)
        modules[f"link_{i}"] = link(*pair, float(stiffness), float(damping))
    mass, friction = (10.0 ** rng.uniform(*span, hands) for span in ((-1.2, 0.0), (-0.3, 0.5)))
    device = {"mass": mass.tolist(), "friction": friction.tolist(), "delay": float(rng.choice([0.5, 1.0]))}
    substeps = {"substeps": int(rng.choice([2, 5]))} if rng.random() < 0.3 else {}
    return scene_of(modules, hands, device=device, **substeps)


def measured(scene: Scene, one: Part, duration: float | None = None) -> HandsMeasurement:
    return measure_hands(scene, channels=one.channels, duration=duration, run=run_in_memory)


def both(scene: Scene, duration: float | None = None) -> tuple[HandsMeasurement, Any]:
    """Returns the measurement of a scene of one part, and what is felt by its prediction."""
    (one,) = predict(scene, with_margins=False).parts
    return measured(scene, one, duration), one.felt


class TestMatrices:
    def test_of_two_hands_that_are_tied_are_those_of_the_prediction(self) -> None:
        """Nothing holds them: they go on together, and the place where they stop is one of their motions."""
        found, _ = both(scene_of(TIED))
        np.testing.assert_allclose(found.k, 2167.8914017232 * np.array([[1, -1], [-1, 1]]), rtol=2e-6)
        np.testing.assert_allclose(found.b, np.eye(2) + 1.9923820182 * np.array([[1, -1], [-1, 1]]), rtol=4e-6)

    @pytest.mark.thorough(keep=1)
    @pytest.mark.parametrize("seed", [3, 5, 8])
    def test_of_hands_that_nothing_holds(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        hands = int(rng.integers(2, 4))
        stiffness, damping = 10.0 ** rng.uniform(2.0, 3.5, hands), 10.0 ** rng.uniform(-0.5, 0.8, hands)
        ties = {
            f"tie_{i}": link(f"hand_{i - 1}", f"hand_{i}", float(stiffness[i]), float(damping[i]))
            for i in range(1, hands)
        }
        found, felt = both(scene_of(ties, hands))
        np.testing.assert_allclose(found.k, felt.k, atol=1e-5 * np.abs(felt.k).max())

    @pytest.mark.parametrize(
        "more",
        [{"mock": {"misses": 0.02}}, {"device": {"delay": 3}}, {"device": {"force_limit": 2.0}}],
        ids=["positions that never come", "a long delay", "a force that is clipped"],
    )
    def test_of_what_a_device_does_besides(self, more: dict[str, Any]) -> None:
        found, felt = both(scene_of({"tie": link("hand_0", "hand_1", 500.0, 5.0)} | HOLD, **more))
        np.testing.assert_allclose(found.k, felt.k, atol=1e-5 * np.abs(felt.k).max())
        np.testing.assert_allclose(found.b, felt.b, atol=3e-5 * np.abs(felt.b).max())

    @pytest.mark.parametrize(
        ("tie", "friction"),
        [
            (link("hand_0", "hand_1", 600.0, 1.0) | {"type": "buffer"}, 1.0),
            (link("hand_0", "hand_1", 600.0, 40.0), 35.0),
        ],
        ids=["a contact opens", "damping is beyond what swings"],
    )
    def test_are_refused_where_no_springs_and_dampers_move_so(self, tie: dict[str, Any], friction: float) -> None:
        hold = link("hand_0", "wall", 200.0, float(tie["damping"]))
        mock = {"initial": {"velocity": [0.05, 0.0]}}
        device = {"mass": [0.15, 0.2], "friction": [friction, 1.2 * friction]}
        with pytest.raises(UsageError, match="springs and dampers"):
            both(scene_of({"tie": tie, "hold": hold}, device=device, mock=mock))

    @pytest.mark.parametrize("seed", SEEDS)
    def test_of_random_scenes_are_those_of_the_prediction(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        compared = 0
        while not compared:
            scene = random_scene(rng)
            prediction = predict(scene, with_margins=False)
            for one in prediction.parts if prediction.stable else ():
                if one.felt.reason or len(one.names) < 2:
                    continue
                found, compared = measured(scene, one), compared + 1
                np.testing.assert_allclose(found.k, one.felt.k, atol=1e-4 * np.abs(one.felt.k).max())
                np.testing.assert_allclose(found.b, one.felt.b, atol=1e-4 * np.abs(one.felt.b).max())

    def test_do_not_depend_on_where_the_scene_rests(self) -> None:
        walls = ({"wall": {"type": "ground", "position": position}} for position in (0.0, 0.002))
        here, there = (both(scene_of(TIED | HOLD | wall))[0] for wall in walls)
        np.testing.assert_allclose(there.k, here.k, rtol=1e-5)
        np.testing.assert_allclose(there.b, here.b, rtol=1e-5)

    @pytest.mark.thorough
    def test_are_as_uncertain_as_stated_with_noise(self) -> None:
        off = []
        for seed in range(5):
            found, felt = both(scene_of(TIED | HOLD, mock={"noise": 2e-6, "seed": seed}))
            off += [(found.k - felt.k) / found.k_uncertainty, (found.b - felt.b) / found.b_uncertainty]
        assert 0.5 < float(np.sqrt(np.mean(np.square(off)))) < 1.5
        assert float(np.abs(off).max()) < 5.0

    def test_are_not_reported_where_too_little_moves(self) -> None:
        with pytest.raises(UsageError, match=r"show clearly the 4 decaying modes of 2 springs and dampers"):
            both(scene_of(TIED | HOLD, mock={"noise": 1e-4}))

    def test_name_other_motions_where_these_are_stronger(self) -> None:
        poles, energy = np.array([0.9, 0.8 + 0.1j, 0.8 - 0.1j]), np.array([4.0, 3.0, 2.9])
        with pytest.raises(UsageError, match=r"other motions, as of simulated masses, have 29 % of the energy"):
            _hand_modes(_Modes(poles, np.ones((1, 3), complex), energy), 1)

    def test_need_a_record(self) -> None:
        with pytest.raises(UsageError, match="too little of the free motion was recorded without a gap"):
            both(scene_of(TIED), duration=0.1)


def test_the_command_shows_both_sides(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "tied.yaml"
    path.write_text(text_of(TIED))
    out = hapsim("measure", path, "--hands").out
    rows = {
        row[0].strip(): [cell.strip() for cell in row[1:5]]
        for row in (line.split("│")[1:] for line in out.splitlines())
        if len(row) > 4
    }
    assert list(rows)[2:4] == ["hand_0 of hand_1: k  N/m", "hand_0 of hand_1: b  N·s/m"]
    predicted, found, off, *_ = rows["hand_0 of hand_1: k  N/m"]
    assert float(predicted) == pytest.approx(2167.891, abs=1e-3)
    assert float(found) == pytest.approx(float(predicted), abs=3.0 * float(off))
    document = hapsim("measure", path, "--hands", "--json").document["hands"]
    assert document["device_points"] == ["hand_0", "hand_1"]
    np.testing.assert_allclose(document["measured"]["k"], document["predicted"]["k"], rtol=2e-6)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["wall", "--hands"], "--hands: the hand on channel 0 is linked to no other"),
        (["two_hands", "--hands", "--channel", "7"], "channel 7: the scene has nothing there"),
        (["wall", "--mass", "--hand-stiffness", "3", "--channel", "7"], "channel 7: the scene has nothing there"),
        (["wall", "--mass"], "--mass: no hand holds the mock; expected mock.hand.stiffness, or --hand-stiffness KH"),
        (["wall", "--mass", "--hand-stiffness", "-1"], "--hand-stiffness: found -1, expected a finite number"),
        (["wall", "--mass", "--port", "x"], "--mass: the stiffness of the hand that holds the device is missing"),
    ],
)
def test_what_does_not_fit_is_reported(hapsim: Hapsim, words: list[str], told: str) -> None:
    answer = hapsim("measure", *words)
    assert (answer.status, told in " ".join(answer.err.split())) == (2, True)


class TestWeight:
    """The figures are from 50 digits: a device of 0.4 kg, 1 N·s/m, at 4 kHz, behind 800 N/m and 2 N·s/m 2.4 kg."""

    FREE: ClassVar[dict[str, Any]] = {
        "ball": {"type": "mass", "mass": 2.4},
        "touch": link("hand_0", "ball", 800.0, 2.0),
    }

    @pytest.mark.parametrize(
        ("stiffness", "felt"),
        [(50.0, 2.529150257), (150.0, 2.793588867), (300.0, 3.200173514), (1000.0, 5.184818350)],
    )
    def test_is_that_of_the_prediction(self, hapsim: Hapsim, tmp_path: Path, stiffness: float, felt: float) -> None:
        path = tmp_path / "free.yaml"
        path.write_text(text_of(self.FREE, 1, rate=4000, device={"mass": 0.4}))
        document = hapsim("measure", path, "--mass", "--hand-stiffness", stiffness, "--json").document["felt_mass"]
        assert document["predicted"] == pytest.approx(felt, rel=1e-9)
        assert document["measured"] == pytest.approx(felt, rel=1e-4)
        assert abs(document["measured"] - felt) < 5.0 * document["uncertainty"]

    def test_is_felt_by_the_hand_of_the_mock(self, hapsim: Hapsim, tmp_path: Path) -> None:
        path = tmp_path / "free.yaml"
        path.write_text(text_of(self.FREE, 1, rate=4000, device={"mass": 0.4}, mock={"hand": {"stiffness": 300.0}}))
        told = " ".join(hapsim("measure", path, "--mass").out.split())
        assert "Moved to and fro by a hand of 300 N/m, it feels like 3.2" in told
        assert "kg (predicted: 3.20017; without sampling and delay 3.19996)" in told

    def test_of_a_wall_is_none(self, hapsim: Hapsim) -> None:
        path = "configs/paper_6_3_real_damping.yaml"
        assert load_scene(path).device.port is None
        told = " ".join(hapsim("measure", path, "--mass", "--hand-stiffness", "100").out.split())
        assert "it oscillates no slower than the device alone: the felt mass is zero" in told


def test_a_channel_that_no_hand_is_on_is_named_before_any_hand_is_pushed() -> None:
    with pytest.raises(UsageError, match="channel 1: the scene has nothing there"):
        measure_hands("first_touch", channels=(0, 1), run=lambda *_, **__: pytest.fail("a hand is pushed"))
