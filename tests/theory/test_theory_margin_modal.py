"""Margins by the modes of a scene's structures: the same as by eliminating every point, and sooner."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hapsim.theory import Network
from hapsim.theory.interface import damper_named
from hapsim.theory.network import margin, margins_of, solve, state, transition
from hapsim.theory.network.margin_modal import ModalResponse, NotModalError
from hapsim.theory.network.margin_response import Response

RATE = 1000.0
Link = tuple[int, int, float, float, str]
ONE_HAND: Sequence[Link] = [(0, 20, 100.0, 0.1, "backward")]
SEVERAL: Sequence[Link] = [
    (0, 20, 100.0, 0.1, "sensed"),
    (1, 33, 50.0, 0.2, "centred"),
    (0, 1, 20.0, 0.05, "sensed"),
    (27, 33, 10.0, 0.0, "backward"),
    (-1, 20, 5.0, 0.01, "filtered"),
    (0, -1, 30.0, 0.3, "backward"),
]


def skin(rows: int, links: Sequence[Link], friction: float = 0.0, **changed: object) -> Network:
    """A square membrane between four edges, its first mass number 2, behind two hands; margins are asked of links."""
    number = np.arange(rows * rows).reshape(rows, rows) + 2
    padded = np.pad(number, 1, constant_values=-1)
    across = np.stack([padded[1:-1, :-1].ravel(), padded[1:-1, 1:].ravel()], axis=1)
    down = np.stack([padded[:-1, 1:-1].ravel(), padded[1:, 1:-1].ravel()], axis=1)
    ends = np.vstack(
        [[link[:2] for link in links], across, down, np.stack([number.ravel(), -1 + 0 * number.ravel()], 1)]
    )
    inner = len(across) + len(down)
    arguments = {
        "rate": RATE,
        "channel_mass": [0.2, 0.1],
        "channel_friction": [1.0, 0.5],
        "delay": 1.0,
        "hold": "zoh",
        "sampling": "ideal",
        "point_mass": np.full(rows * rows, 0.001),
        "ends": ends,
        "stiffness": [*(link[2] for link in links), *[100.0] * inner, *[0.0] * number.size],
        "damping": [*(link[3] for link in links), *[0.01] * inner, *[friction] * number.size],
        "damper": [
            *(damper_named(link[4], 80.0 if link[4] == "filtered" else None, RATE) for link in links),
            *[damper_named("backward", None, RATE)] * (inner + number.size),
        ],
        "margin_links": len(links),
    }
    return Network(**(arguments | changed))  # type: ignore[arg-type]


@pytest.mark.parametrize("links", [ONE_HAND, SEVERAL], ids=["one", "several"])
@pytest.mark.parametrize("changed", [{}, {"sampling": "average", "delay": 0.3}, {"hold": "impulse"}])
@pytest.mark.parametrize("friction", [0.0, 0.02])
def test_the_answers_are_those_of_the_elimination(links: Sequence[Link], changed: dict, friction: float) -> None:
    scene = skin(7, links, friction, **changed)
    angles = np.concatenate([np.geomspace(1e-6, 0.1, 30), np.linspace(0.1, 3.14, 100)])
    by_modes = ModalResponse(scene)
    eliminated = Response(scene)
    wanted = np.arange(by_modes.links.size)
    np.testing.assert_array_equal(by_modes.links, eliminated.links[wanted])
    with np.errstate(divide="ignore", invalid="ignore"):  # a link without damping has no factor of it
        pairs = list(zip(by_modes.at(angles), eliminated.at(angles, wanted), strict=True))
        last = by_modes.at(angles, wanted[-1:])
    for found, expected in pairs:
        finite = np.isfinite(expected)
        np.testing.assert_allclose(found[finite], expected[finite], rtol=1e-9)
    np.testing.assert_array_equal(last.stiffness, pairs[0][0][-1:])


def test_a_structure_that_is_damped_unevenly_has_no_modes_of_its_own() -> None:
    scene = skin(8, ONE_HAND, 0.02)
    damping = scene.damping.copy()
    damping[-5] *= 1.0 + 1e-9
    with pytest.raises(NotModalError):
        ModalResponse(replace(scene, damping=damping))
    with pytest.raises(NotModalError):
        ModalResponse(replace(scene, margin_links=None))


@pytest.mark.parametrize("links", [ONE_HAND, SEVERAL], ids=["one", "several"])
def test_margins_are_where_the_poles_leave_the_circle(links: Sequence[Link], monkeypatch: pytest.MonkeyPatch) -> None:
    dense = skin(11, links)
    monkeypatch.setattr(state, "LARGE", 100)
    monkeypatch.setattr(margin, "QUICK", 0)
    scene = skin(11, links)
    assert isinstance(margin._response(scene), ModalResponse)
    for link, factors in enumerate(margins_of(scene).links):
        for name, factor in zip(("stiffness", "damping"), factors, strict=True):
            if not np.isfinite(factor):
                continue
            for beside, outside in ((0.999, False), (1.001, True)):
                value = getattr(dense, name).copy()
                value[link] *= factor * beside
                poles = np.linalg.eigvals(transition(replace(dense, **{name: value})).toarray())
                assert (np.abs(poles).max() > 1.0 + 1e-9) == outside, (link, name, factor)


def test_thirty_rows_of_thirty_are_followed_as_finely_as_they_resonate() -> None:
    scene = skin(30, ONE_HAND)
    poles = solve(scene).poles
    before = time.process_time()
    margins = margins_of(scene, poles)
    found = margins.links[0]
    assert time.process_time() - before < 10.0  # with an elimination for each angle, about 10 s on two processors
    assert "coarser" not in margins.method
    assert found.stiffness_factor > 1.0
    assert found.damping_factor > 1.0
