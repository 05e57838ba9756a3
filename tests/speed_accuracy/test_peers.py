"""The peers of the bench "speed against accuracy" simulate the string that they are asked for."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from speed.peers import every_peer
from speed.peers.c_network import CNetwork
from speed.peers.c_spring import CSpring
from speed.peers.c_stencil import CStencil
from speed.peers.faust_mi import FaustMi
from speed.peers.faust_model import Drive

from hapsim.speed_accuracy.strings import StringOfMasses, hand_link, hand_motion

RATE = 10_000.0
STRING = StringOfMasses.tuned(10)
PEERS = every_peer()

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")


def _forces_of(peer: CStencil | CNetwork, motion: np.ndarray) -> np.ndarray:
    run = peer.running(STRING, RATE)
    run.start_in(np.zeros(STRING.masses))
    run.hold(*hand_link(STRING))
    return run.run(motion)


def _skip_unless_available(peer) -> None:
    if reason := peer.available():
        pytest.skip(reason)


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_every_peer_rings_near_the_string_in_continuous_time(peer):
    _skip_unless_available(peer)
    found = peer.frequencies(STRING, RATE, [1, 3])
    assert found == pytest.approx([STRING.frequency(1), STRING.frequency(3)], rel=1e-4)


@needs_cc
@pytest.mark.parametrize("peer", [CStencil(), CStencil(hand=True), CNetwork()], ids=lambda peer: peer.name)
def test_the_c_programs_ring_where_the_centred_scheme_does(peer):
    string = StringOfMasses.tuned(10, damping_ratio=0.0)
    omega = [2.0 * math.pi * string.frequency(j) for j in (1, 5, 10)]
    warped = [math.asin(w / (2.0 * RATE)) * RATE / math.pi for w in omega]
    assert peer.frequencies(string, RATE, [1, 5, 10]) == pytest.approx(warped, rel=1e-10)


@needs_cc
def test_beyond_the_limit_of_stability_there_is_no_frequency():
    limit = math.pi * STRING.frequency(10)
    assert all(map(math.isnan, CStencil().frequencies(STRING, 0.99 * limit, [1, 10])))
    assert all(map(math.isnan, CNetwork().frequencies(STRING, 0.1 * limit, [1, 10])))
    assert not any(map(math.isnan, CStencil().frequencies(STRING, 1.1 * limit, [1, 10])))


@needs_cc
def test_a_hand_feels_the_same_force_from_stencil_network_and_faust():
    motion = hand_motion(5000, RATE)
    stencil = _forces_of(CStencil(hand=True), motion)
    tolerance = 1e-11 * np.max(np.abs(stencil))
    np.testing.assert_allclose(_forces_of(CNetwork(), motion), stencil, rtol=0, atol=tolerance)
    faust = FaustMi(hand=True)
    _skip_unless_available(faust)
    run = faust.running(STRING, RATE, Drive.HAND)
    assert run is not None
    np.testing.assert_allclose(run.run(motion), stencil, rtol=0, atol=tolerance)


@needs_cc
@pytest.mark.parametrize("how", ["run", "run_called", "run_free"])
def test_the_c_spring_pulls_as_a_spring_and_damper(how):
    motion = hand_motion(100, 1000.0)
    expected = -2000.0 * motion - 2.0 * 1000.0 * np.diff(motion, prepend=0.0)
    np.testing.assert_allclose(CSpring(2000.0, 2.0, 1000.0, how).run(motion), expected, rtol=1e-12)
