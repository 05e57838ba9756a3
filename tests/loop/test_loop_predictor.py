"""The predictor of the loop beside an observer in plain Python: positions lost, forces late or expired, excitations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.loop.exchange import LOOP
from hapsim.loop.hooks import call_hooks, set_hooks
from hapsim.prediction.correction import rendered
from hapsim.running.correction_setup import LoopCorrection
from hapsim.scene import Device, DevicePoint, Ground, Scene, ViscoElastic

MASS, T, LIVES = 0.2, 1e-3, 4
OF_VELOCITY, OF_PUSH = 7.0 / 8.0, 1.0 / 4.0  # with which the poles are 1/2 twice, and 0


@entry
def read(loop):  # type: ignore[no-untyped-def]
    call_hooks(loop.hooks.before_scene, loop.tick)


class Observer:
    """Observer of a free mass with one sample of delay and a zero-order hold; it takes the applied force in every
    sample."""

    def __init__(self) -> None:
        self.x, self.v, self.push, self.samples = 0.0, 0.0, 0.0, 0
        self.acted = [0.0, 0.0]
        """N: of the last samples, the newest last"""
        self.sent = self.before = 0.0

    def moved(self, x: float, v: float, force: float) -> tuple[float, float]:
        a = (force + self.push) / MASS
        return x + v * T + 0.5 * a * T * T, v + a * T

    def read(self, y: float, gap: int, late: bool, expired: bool) -> tuple[float, float]:
        self.samples += 1
        if self.samples == 1:
            self.x = y
            return self.ahead()
        for sample in range(gap):
            newest = self.acted[-1] if sample else self.before if late and gap == 1 else self.sent
            self.acted.append(0.0 if expired and not (sample == 0 and not late and gap == 1) else newest)
            if gap > 1 and sample == 0:
                self.acted[-1] = newest
            self.x, self.v = self.moved(self.x, self.v, self.acted[-2])
        self.before = self.sent
        off = y - self.x
        if self.samples == 2:
            self.x, self.v = y, self.v + off / (gap * T)
        else:
            self.x, self.v = y, self.v + OF_VELOCITY * off / (gap * T)
            self.push += OF_PUSH * MASS * off / (gap * T) ** 2
        return self.ahead()

    def ahead(self) -> tuple[float, float]:
        return self.moved(self.x, self.v, self.acted[-1])


class PostedAtOnce:
    """A mailbox of a loop that stands still."""

    @staticmethod
    def add(record: Any, field: str, value: int) -> None:
        record[field] = value


def test_a_fade_goes_from_the_table_before_to_the_next_one() -> None:
    modules = {
        "hand": DevicePoint(channel=0),
        "wall": Ground(),
        "touch": ViscoElastic(between=("hand", "wall"), stiffness=100.0, damping=1.0),
    }
    device = Device(clock="lockstep", mass=MASS, correction="predictor")
    scene = Scene(version=1, rate=1.0 / T, device=device, modules=modules)
    heavier = rendered(scene.model_copy(update={"device": device.model_copy(update={"mass": 2.0 * MASS})}))
    loop: Any = new_record(LOOP)
    loop.io.channels, loop.tick.gap = 1, 1
    loop.tick.address, loop.tick.io = address_of(loop.tick), address_of(loop.io)
    kept = LoopCorrection(loop, rendered(scene), describe_mock(scene))
    hooks = set_hooks(loop.hooks, kept.hooks)
    assert hooks
    before = kept.tables[0][0, 0].copy()
    for _ in range(20):  # more than the loop reads: none of these is taken during the fade
        kept.fade_to(heavier, 10, PostedAtOnce())  # type: ignore[arg-type]
        after = kept.tables[-1][0, 0].copy()
        if loop.predictor.left == 0:
            read(loop)
    numbers = kept._numbers[0]
    assert np.abs(after - before).max() > 1e-3
    for n in range(2, 10):
        read(loop)
        s = n / 10
        assert numbers == pytest.approx(before + s * s * (3.0 - 2.0 * s) * (after - before), rel=1e-12, abs=1e-15)
    assert len(kept.tables) <= 4


@pytest.mark.parametrize("seed", range(2))
def test_whatever_is_lost_or_late_it_is_the_observer_that_is_written_out(seed: int) -> None:
    modules = {
        "hand": DevicePoint(channel=0),
        "wall": Ground(),
        "table": ViscoElastic(between=("hand", "wall"), stiffness=0.0, damping=1e-9),
    }
    device = Device(clock="lockstep", mass=MASS, correction="predictor")
    scene = Scene(version=1, rate=1.0 / T, device=device, modules=modules)
    loop: Any = new_record(LOOP)
    io, tick = loop.io, loop.tick
    io.channels, io.force_scale[0] = 1, 1e-3
    tick.address, tick.io = address_of(tick), address_of(io)
    loop.control.time_to_live = LIVES
    kept = LoopCorrection(loop, rendered(scene), describe_mock(scene))
    hooks = set_hooks(loop.hooks, kept.hooks)
    assert hooks
    random = np.random.default_rng(seed)
    observer, age = Observer(), 1
    for sample in range(400):
        gap = int(random.choice([1, 1, 1, 2, 3, 7])) if sample else 1
        late = bool(random.random() < 0.3)
        age = min(age + 1, LIVES + 2) if late else 1
        y = float(random.normal(scale=1e-3))
        io.measured[0] = y
        tick.gap, tick.late, tick.age = gap, late, age
        read(loop)
        x, v = observer.read(y, gap, late, age > LIVES)
        assert io.measured[0] == pytest.approx(x, rel=1e-9, abs=1e-15), sample
        assert io.velocity[0] == pytest.approx(v, rel=1e-9, abs=1e-12), sample
        io.force_counts[0] = int(random.integers(-9000, 9000))
        io.as_hand[0] = float(random.normal())  # an excitation: the hand's, of which the predictor knows nothing
        observer.sent = io.force_counts[0] * 1e-3 - io.as_hand[0]
