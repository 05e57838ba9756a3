"""Measurements on the mock with the law on the board: a hand feels the pole of a loop that is written out."""

from __future__ import annotations

from typing import Any

import pytest

from hapsim.measuring.measure import measure
from tests import one_hand


@pytest.mark.parametrize(
    ("device", "k", "b"),
    [
        ({"board_window": 1}, 2009.843658662, 5.727012989),
        ({"board_window": 1, "delay": 3}, 2009.843658662, 5.727012989),
        ({}, 2033.138, 5.7813),
    ],
)
def test_the_hand_feels_the_board_s_loop_whatever_the_delay_of_the_host(
    device: dict[str, Any], k: float, b: float
) -> None:
    """2000 N/m and 5 N·s/m beside 1 N·s/m; the host's law gives 2080.44 and 3.02 at one sample, and none at three."""
    mock = {"initial": {"velocity": 0.1}}
    found = measure(one_hand.scene_of({"touch": one_hand.touch(2000, 5)}, device={"law": "board"} | device, mock=mock))
    assert found.k == pytest.approx(k, rel=1e-5)
    assert found.b == pytest.approx(b, rel=5e-5)
