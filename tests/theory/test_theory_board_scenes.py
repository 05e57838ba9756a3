"""Scenes with the force law on the board, predicted: one hand by its closed form, the others by the whole loop."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

from firmware_protocol.lines import Lines
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.prediction.board_words import carried, change_sentences, crossing_sentences, sent_sentences
from hapsim.prediction.verdict_words import predicted_for
from hapsim.prediction.virtual_coupling import virtual_couplings
from hapsim.scene import Scene, parse_scene
from hapsim.theory.interface import BoardLaw
from hapsim.theory.network import felt_pair, poles_of
from tests.board_loops import T, Written, one_sample

SPRING = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000.0, "damping": 5.0}


def scene_of(modules: Any = None, rate: float = 1000.0, touch: Any = None, **device: Any) -> Scene:
    """A hand on a wall; of `touch` other numbers."""
    given = {"mass": 0.2, "friction": 1.0, "law": "board"} | device
    every = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": SPRING | (touch or {})}
    whole = {"version": 1, "rate": rate, "device": given, "modules": every | (modules or {})}
    return parse_scene(yaml.safe_dump(whole))


def test_a_hand_on_a_wall_feels_the_same_at_every_delay_of_the_wire() -> None:
    for delay in (0.0, 1.0, 2.3, 17.0):
        prediction = predict(scene_of(delay=delay, board_window=1))
        (felt,) = prediction.felt
        assert (felt.k, felt.b) == pytest.approx((2009.843658662, 5.727012989), rel=1e-9)
        assert prediction.stable
        assert felt.delay == 0.1
        whole = felt_pair(prediction.network)
        assert (whole.k[0, 0], whole.b[0, 0]) == pytest.approx((felt.k, felt.b), rel=1e-9)
        assert np.abs(poles_of(prediction.network)).max() == pytest.approx(felt.spectral_radius, rel=1e-12)
        assert prediction.margins[0].stiffness_factor == pytest.approx(39_894.456 / 2000.0, rel=1e-7)
    assert not predict(scene_of(touch={"stiffness": 40_000.0}, board_window=1)).stable
    assert "law on the board at 10 kHz (0.1 ms of delay, velocities over 0.1 ms)" in predicted_for(prediction.scene)


REMEMBERING = {
    "brake": {"type": "nonlinear", "force_over_velocity": [[-1.0, -1.0], [1.0, 1.0]]},
    "rub": {"type": "friction", "force": 0.1, "stiffness": 500.0},
    "pick": {"type": "plectrum", "stiffness": 500.0, "release": 0.01},
    "knob": {"type": "detent", "pitch": 0.01, "depth": 0.1, "hold_until": 0.75},
}


@pytest.mark.parametrize("name", REMEMBERING)
def test_what_is_not_simulated_is_judged_by_its_states(name: str) -> None:
    link = {"between": ["hand", "wall"], **REMEMBERING[name]}
    table = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": [[0.0, 0.0], [0.01, 1.0]]}
    for modules in ({name: link}, {name: link, "table": table}):
        prediction = predict(scene_of(modules))
        assert (prediction.verdict, prediction.stable, prediction.judge.swings) == ("stable", True, {})


def test_poles_are_corrected_for_the_loop_of_the_board() -> None:
    (felt,) = predict(scene_of(correction="poles", delay=3.0)).felt
    assert (felt.k, felt.b) == pytest.approx((2000.0, 6.0), rel=1e-9)


def test_a_slower_clock_of_the_board_is_felt_as_that_of_a_device() -> None:
    (felt,) = predict(scene_of(board_window=1)).felt
    slow = felt.at_rate(990.0)
    assert slow.configuration.rate == 9900.0
    assert slow.damping == pytest.approx(5.0 / 0.99)


def test_the_noise_of_a_force_is_that_of_the_loop_in_time() -> None:
    """Readings with noise of 1 m rms, by the spread of the forces of 200 000 local periods."""
    (felt,) = predict(scene_of(board_window=3, touch={"damping": 20.0})).felt
    h, m, b0, rng = T / 10.0, 0.2, 1.0, np.random.default_rng(1)
    decay = math.exp(-b0 / m * h)
    moved, noise = (1.0 - decay) * m / b0, rng.normal(size=200_000)
    x = v = f = 0.0
    seen, forces = [0.0] * 3, []
    for one in noise.tolist():
        read = x + one
        computed = -2000.0 * read - 20.0 * (read - seen[2]) / (3.0 * h)
        seen = [read, *seen[:2]]
        x, v = x + moved * v + (h - moved) * f / b0, decay * v + (1.0 - decay) * f / b0
        f = computed
        forces.append(computed)
    assert felt.robustness.noise_gain == pytest.approx(float(np.std(forces[2000:])), rel=0.02)


def test_what_the_board_would_change_is_in_the_explanation() -> None:
    by_host = scene_of(law="host")
    first, hand = change_sentences(by_host, predict(by_host))
    assert first == "With `law: board` under `device`, on a board at 10 kHz, the scene would be stable:"
    assert "hand feels k = 2033.14 N/m, b = 5.781 N·s/m (now 2080.44, 3.021)" in hand
    assert "stable up to 19.2 times the stiffness (now 1.947)" in hand
    assert "stable in any hand with 2.254 N·s/m of friction (now 6.1)" in hand
    mean = scene_of(law="host", decimation="mean")
    (sentence,) = change_sentences(mean, predict(mean))
    assert "does not fit this scene: device.decimation: found mean" in sentence
    fast = scene_of(law="host", rate=8000.0)
    assert not [*change_sentences(fast, predict(fast))]
    assert not [*change_sentences(scene_of(), predict(scene_of()))]


@pytest.mark.parametrize("late", [10, 30])
def test_k_and_b_are_felt_as_the_wire_carries_them(late: int) -> None:
    scene = scene_of(delay=late / 10.0, touch={"stiffness": 1234.5, "damping": 4.321})
    prediction = predict(scene, with_margins=False)
    lines = Lines(10, 1, 10, 32, (2.0,), (0.01,), (70_000.0,), (100.0,))
    (sentence,) = sent_sentences(prediction, lines)
    assert sentence.startswith("hand: the wire carries 1234.5 N/m, 4.321 N·s/m as 1234 N/m, 4.32 N·s/m, felt as ")
    loop = Written([0.2], [1.0], [0.0], [], [(0, -1, 1234.5, 4.321)], late, BoardLaw(10, 1, 10), sent=((1234.0, 4.32),))
    poles = np.linalg.eigvals(one_sample(loop))
    s = np.log(poles[np.argmax(np.abs(poles) * (poles.imag > 0.0))]) / T
    (felt,) = carried(prediction, lines).felt
    assert (felt.k, felt.b) == pytest.approx(
        (0.2 * abs(s) ** 2, -0.4 * s.real), rel=2e-5
    )  # to first order in what k lacks
    (beyond,) = sent_sentences(prediction, replace(lines, largest_stiffness=(1000.0,)))
    assert "the wire does not carry its line" in beyond
    assert not [*sent_sentences(prediction, None)]


def test_pieces_that_are_narrower_than_the_way_of_a_sample_are_named_with_their_links() -> None:
    detent = {"type": "detent", "between": ["hand", "wall"], "pitch": 0.001, "depth": 0.2, "shape": "snap"}
    place = {"type": "ground", "position": 0.0001}
    stop = {"type": "buffer", "between": ["hand", "place"], "stiffness": 500.0}
    scene = scene_of({"click": detent, "place": place, "stop": stop})
    found = [*crossing_sentences(scene, predict(scene, with_margins=False))]
    assert found == [
        "hand: faster than 0.333 m/s it crosses a piece of click, 0.333 mm, between two lines.",
        "hand: faster than 0.233 m/s it crosses the way between click and stop, 0.233 mm, between two lines.",
    ]
    assert not [*crossing_sentences(scene_of(), predict(scene_of()))]


def test_what_is_not_derived_is_refused() -> None:
    many = {"string": {"type": "string", "masses": 600, "mass": 0.001, "stiffness": 1000.0, "damping": 0.01}}
    link = {"type": "viscoelastic", "between": ["hand", "string.3"], "stiffness": 10.0}
    with pytest.raises(UsageError, match=r"numbers in its state, expected host"):
        predict(scene_of(many | {"pull": link}))
    with pytest.raises(UsageError, match=r"device[.]law: found board, expected host"):
        virtual_couplings(scene_of())
