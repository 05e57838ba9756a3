"""The mock's motor and transmission against the exponential of the matrix of each of its states (in mesh, free,
sliding, stuck), between events that a search finds; its cogging against an integration."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.device.mock import transmission as drives
from hapsim.device.mock.motion import BODY
from hapsim.device.mock.transmission import DRIVE
from hapsim.errors import UsageError

New = Callable[..., Any]
BELT = {"stiffness": 2e4, "damping": 3.0, "motor_mass": 0.05}
_POINTS = 300  # of an interval, between which the search expects one event at most


@entry
def move_driven(drive: Any, body: Any, force: float, h: float) -> None:
    drives.move_driven(drive, body, force, h)


class Referee(NamedTuple):
    """Two masses and a belt. The state: positions and velocities of motor and handle, the force on the motor, the
    commanded one, its slope, and 1."""

    motor: float
    handle: float
    k: float
    c: float
    backlash: float
    motor_friction: float
    friction: float
    spring: float
    push: float
    coulomb: float
    rough: int
    lag: float

    def pressing(self, side: int) -> np.ndarray:
        """Row of what the teeth of a side press, of the state."""
        half = side * self.backlash / 2
        return np.array([self.k, self.c, -self.k, -self.c, 0, 0, 0, -self.k * half])

    def rates(self, mesh: int | None) -> np.ndarray:
        """Derivative of the state, without dry friction. `mesh`: the side that presses; None: neither does."""
        a, press = np.zeros((8, 8)), np.zeros(8) if mesh is None else self.pressing(mesh)
        a[0, 1] = a[2, 3] = a[5, 6] = 1
        a[1, 4 if self.lag else 5], a[1, 1], a[3, 3] = 1, -self.motor_friction, -self.friction
        a[3, [2, 7]] = -self.spring, self.push
        a[1], a[3] = (a[1] - press) / self.motor, (a[3] + press) / self.handle
        if self.lag:
            a[4, [4, 5]] = -1 / self.lag, 1 / self.lag
        return a

    @property
    def gaps(self) -> dict[int, np.ndarray]:
        """Rows of what the teeth of each side overlap, of the state."""
        return {side: np.array([side, 0, -side, 0, 0, 0, 0, -self.backlash / 2]) for side in (1, -1)}

    def belt_ends(self, mesh: int | None, state: np.ndarray) -> list[tuple[np.ndarray, str, int]]:
        """Functions of the state that are positive up to an event of the teeth, its name and its side."""
        if not self.backlash or mesh is not None:
            return [(mesh * self.pressing(mesh), "leaves", 0)] if self.backlash and mesh is not None else []
        ends = []
        for side, gap in self.gaps.items():
            parted = gap @ state > 1e-15
            ends.append((-side * self.pressing(side) if parted else -gap, "meshes", side))
            ends += [(gap, "apart", side)] * int(parted)
        return ends

    def move(self, state: np.ndarray, h: float) -> tuple[np.ndarray, int]:
        """Returns the state after `h` seconds, and the number of events."""
        gaps = self.gaps.items()
        pressed = [side for side, gap in gaps if gap @ state > 0 and side * self.pressing(side) @ state > 0]
        mesh: int | None = 1 if not self.backlash else next(iter(pressed), None)
        at, mass, loose = 2 * self.rough + 1, (self.motor, self.handle)[self.rough], 0
        for events in itertools.count():
            rates = self.rates(mesh)
            pull, way = mass * rates[at], np.sign(state[at])
            if way == 0 and self.coulomb:
                way = loose or (np.sign(pull @ state) if abs(pull @ state) > self.coulomb else 0)
            rates[at, 7] -= self.coulomb * way / mass
            ends = self.belt_ends(mesh, state)
            if self.coulomb and way == 0:
                rates[at] = 0
                ends += [(self.coulomb * np.eye(8)[7] - side * pull, "loose", side) for side in (1, -1)]
            elif self.coulomb:
                ends.append((way * np.eye(8)[at], "stops", 0))
            step = expm(rates * h / _POINTS)
            states = np.empty((_POINTS + 1, 8))
            states[0] = state
            for i in range(_POINTS):
                states[i + 1] = step @ states[i]
            firsts = []
            for row, what, side in ends:
                values = states @ row
                after = np.nonzero((values[1:] <= 0) & (values[:-1] > 0))[0]
                if after.size:
                    start = states[after[0]]
                    root = brentq(value_at, 0, h / _POINTS, (row, rates, start), xtol=1e-18, rtol=1e-15)
                    firsts.append((after[0] * h / _POINTS + root, what, side, expm(rates * root) @ start))
            if not firsts:
                return states[-1], events
            gone, what, side, state = min(firsts, key=lambda one: one[0])
            h, loose = h - gone, side if what == "loose" else 0
            if what == "stops":
                state[at] = 0
            elif what in ("leaves", "meshes"):
                mesh = None if what == "leaves" else side
        raise AssertionError


def value_at(t: float, row: np.ndarray, rates: np.ndarray, start: np.ndarray) -> float:
    return float(row @ expm(rates * t) @ start)


def pair_of(referee: Referee, sensor: int = 0) -> tuple[Any, Any]:
    """A DRIVE and a BODY that are as the referee says."""
    drive, body = new_record(DRIVE), np.zeros(1, BODY).view(np.recarray)[0]
    names = ("motor_mass", "stiffness", "damping", "backlash", "motor_friction")
    for name, value in zip(names, referee, strict=False):
        drive[name] = referee.k if name == "stiffness" else value
    drive.stiffness, drive.damping, drive.backlash = referee.k, referee.c, referee.backlash
    drive.motor_friction, drive.rough, drive.lag, drive.sensor = (
        referee.motor_friction,
        referee.rough,
        referee.lag,
        sensor,
    )
    body.mass, body.friction = referee.motor + referee.handle, referee.motor_friction + referee.friction
    body.stiffness, body.push, body.coulomb = referee.spring, referee.push, referee.coulomb
    return drive, body


def random_pair(random: np.random.Generator, **fixed: float) -> Referee:
    whole, share = 10 ** random.uniform(-1.2, -0.2), random.uniform(0.1, 0.6)
    k = 10 ** random.uniform(3, 5)
    own = {
        "motor": share * whole,
        "handle": (1 - share) * whole,
        "k": k,
        "c": random.choice([0, random.uniform(0, 0.3)]) * math.sqrt(k * whole * share * (1 - share)),
        "backlash": random.choice([0, 1e-5, 1e-4, 5e-4]),
        "motor_friction": random.uniform(0, 2),
        "friction": random.uniform(0, 1),
        "spring": random.choice([0, 100.0]),
        "push": 0.3,
        "coulomb": random.choice([0, random.uniform(0, 1)]),
        "rough": int(random.integers(2)),
        "lag": random.choice([0, 1e-4, 1e-3]),
    }
    return Referee(**(own | fixed))


def compared(random: np.random.Generator, referee: Referee, sensor: int, ramps: bool = True) -> tuple[float, int]:
    """Largest difference in 12 intervals, as a share of the largest position so far, and the number of events."""
    drive, body = pair_of(referee, sensor)
    state, size, off, events = np.eye(8)[7], 0.0, 0.0, 0
    for _ in range(12):
        state[5], state[6] = random.normal(0, 3), random.choice([0, random.normal(0, 1e3)]) if ramps else 0
        h, body.slope = 10 ** random.uniform(-4, -2.6), state[6]
        move_driven(drive, body, state[5], h)
        state, happened = referee.move(state, h)
        size, events = max(size, *np.abs(state[[0, 2]])), events + happened
        off = max(off, float(np.abs(drive.position - state[[0, 2]]).max()) / size)
        assert body.position == drive.position[sensor]
    assert size > 1e-6
    return off, events


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("seed", range(10))
def test_motor_and_handle_move_as_the_exponentials_of_their_states(seed: int) -> None:
    random = np.random.default_rng([71, seed])
    referee = random_pair(random, **({"backlash": 1e-4, "coulomb": 0.4} if seed < 6 else {}))
    off, events = compared(random, referee, seed % 2)
    assert off <= 1e-9
    assert events > 1 or seed >= 6


def test_teeth_that_parted_come_together_without_a_force() -> None:
    """Behind a belt damped so much that they part while they overlap."""
    random = np.random.default_rng([76, 50])
    referee = random_pair(random, backlash=1e-5, coulomb=0, lag=0)
    lighter = referee.motor * referee.handle / (referee.motor + referee.handle)
    off, events = compared(random, referee._replace(c=0.8 * math.sqrt(referee.k * lighter)), 0, ramps=False)
    assert off <= 1e-9
    assert events > 1


def cogged(_t: float, z: np.ndarray, rates: np.ndarray, amplitude: float, wave: float) -> np.ndarray:
    change: np.ndarray = rates @ z
    change[1] -= amplitude * math.sin(wave * z[0])
    return change


@pytest.mark.parametrize("seed", range(4))
def test_cogging_moves_the_motor_as_an_integration_does(seed: int) -> None:
    """To 1e-9 of what it does."""
    random = np.random.default_rng([72, seed])
    referee = random_pair(random, backlash=0, coulomb=0)
    paths = []
    for cogging in (0.5, 0.0):
        own = np.random.default_rng([73, seed])
        drive, body = pair_of(referee)
        drive.cogging, drive.wave = cogging, 2 * math.pi / 10 ** own.uniform(-3.5, -2)
        state = np.eye(8)[7]
        for _ in range(10):
            state[5], state[6] = own.normal(0, 3), own.normal(0, 1e3)
            h, body.slope = 10 ** own.uniform(-4, -2.6), state[6]
            move_driven(drive, body, state[5], h)
            args = (referee.rates(1), cogging / referee.motor, drive.wave)
            if cogging:
                state = solve_ivp(
                    cogged, (0, h), state, "DOP853", args=args, rtol=3e-14, atol=1e-17, max_step=h / 20
                ).y[:, -1]
        paths.append(drive.position.copy())
        if cogging:
            expected = state[[0, 2]]
    effect = np.abs(paths[0] - paths[1]).max()
    assert np.abs(paths[0] - expected).max() <= 1e-9 * effect


@pytest.mark.parametrize("seed", range(4))
def test_energy_never_grows(seed: int) -> None:
    random = np.random.default_rng([74, seed])
    referee = random_pair(random, push=0, backlash=2e-4, coulomb=random.choice([0, 0.1]), lag=0)
    drive, body = pair_of(referee)
    drive.position[:], drive.velocity[:] = random.normal(0, 2e-4, 2), random.normal(0, 0.1, 2)
    before = math.inf
    for _ in range(300):
        stretch = max(abs(drive.position[0] - drive.position[1]) - referee.backlash / 2, 0)
        energy = referee.motor * drive.velocity[0] ** 2 + referee.handle * drive.velocity[1] ** 2
        energy += referee.spring * drive.position[1] ** 2 + referee.k * stretch**2
        assert energy <= before * (1 + 1e-12)
        before = energy
        move_driven(drive, body, 0.0, 1e-4)


def moved(host: Any, forces: np.ndarray, now: int = 0) -> np.ndarray:
    """Positions (m) of motor and handle after each force (N) on every channel."""
    host.arm()
    path = []
    for n, force in enumerate(forces):
        host.force(n, np.rint(force / host.mock.force_scale[0]).astype(int) * np.ones(host.channels, int), now=now)
        path.append([one.position.copy() for one in host.mock.drives[: host.channels]])
    return np.array(path)


FORCES = np.random.default_rng(75).uniform(-2, 2, 60)


def test_a_very_stiff_belt_is_a_rigid_one(new_host: New) -> None:
    hand = {"stiffness": 300.0, "damping": 1.0, "force": 0.4}
    stiff, rigid = (
        new_host(1, device={"friction": 1.0} | own, mock={"hand": hand})
        for own in ({"transmission": BELT | {"stiffness": 1e9, "damping": 1e3}}, {})
    )
    path = moved(stiff, FORCES)[:, 0]
    for n, force in enumerate(FORCES):
        if n == 0:
            rigid.arm()
        rigid.force(n, [round(force / rigid.mock.force_scale[0])])
        assert path[n] == pytest.approx(rigid.bodies["position"][0], abs=1e-6 * np.abs(path).max())
    assert np.abs(path).max() > 1e-4


def test_a_backlash_that_is_never_crossed_shifts_the_handle_by_its_half(new_host: New) -> None:
    """The hand presses the handle against the motor, and the device's friction is on the handle."""
    hand, belt = {"force": -5.0, "damping": 30.0}, BELT | {"friction_at": "handle"}
    parted = new_host(1, device={"transmission": belt | {"backlash": 1e-4}, "friction": 1.0}, mock={"hand": hand})
    joined = new_host(1, device={"transmission": belt, "friction": 1.0}, mock={"hand": hand})
    pulls = np.linspace(3.0, 5.0, 300) + 0.2 * np.sin(np.arange(300) / 40)
    with_play, without = moved(parted, pulls)[:, 0], moved(joined, pulls)[:, 0]
    assert np.diff(with_play[200:] - without[200:], axis=1) == pytest.approx(-5e-5, abs=1e-9)


@pytest.mark.parametrize("sensor", ["motor", "handle"])
@pytest.mark.parametrize(("hold", "delay"), [("zoh", 1.0), ("zoh", 0.4), ("ramp", 1.3), ("impulse", 1.0)])
def test_held_and_late_forces_act_on_the_motor_and_the_position_is_that_of_the_sensor(
    new_host: New, hold: str, delay: float, sensor: str
) -> None:
    lag = 0.0 if hold == "impulse" else 4e-4
    device = {
        "transmission": BELT | {"sensor": sensor},
        "motor_lag": lag,
        "hold": hold,
        "delay": delay,
        "friction": 1.0,
    }
    host = new_host(1, device=device, mock={"saturation": {"force": 2.0, "share": 0.3}})
    path = moved(host, FORCES[:20])[:, 0]
    referee = Referee(0.05, 0.15, 2e4, 3.0, 0, 1.0, 0, 0, 0, 0, 0, lag)
    soft = (1 / 0.7**2 - 1) / 4
    forces = np.round(FORCES / host.mock.force_scale[0]) * host.mock.force_scale[0]
    given = np.concatenate([np.zeros(4), forces / np.sqrt(1 + soft * forces**2)])
    state, part = np.eye(8)[7], delay % 1.0
    for n in range(20):
        now = n + 4 - math.floor(delay)
        for length, at in ((part, now - 1), (1 - part, now)):
            if hold == "impulse" and length == 1.0:
                state[1] += given[at] * 1e-3 / 0.05
            state[5], state[6] = (given[at], 0.0) if hold == "zoh" else (0.0, 0.0)
            if hold == "ramp":
                since = 1 - part if at < now else 0.0
                state[6] = (given[at] - given[at - 1]) / 1e-3
                state[5] = given[at - 1] + since * 1e-3 * state[6]
            state = expm(referee.rates(1) * length * 1e-3) @ state
        assert path[n] == pytest.approx(state[[0, 2]], rel=1e-9, abs=1e-15)
    assert host.bodies["position"][0] == path[-1, int(sensor == "handle")]


def test_a_force_that_expires_leaves_the_motor_without_one(new_host: New) -> None:
    host = new_host(1, device={"transmission": BELT, "motor_lag": 2e-4, "delay": 0.5})
    host.arm(schema.PACED_BY_HOST)
    host.send(host.force_frame(0, [2**29], time_to_live=0), now=1_000_000)
    host.force(1, [-(2**28)], now=6_000_000)  # a sample of 1 ms under the forces, and 4 ms without them
    referee, state = Referee(0.05, 0.15, 2e4, 3.0, 0, 0, 0, 0, 0, 0, 0, 2e-4), np.eye(8)[7]
    for counts, h in ((0, 0.5e-3), (2**29, 1e-3), (-(2**28), 0.5e-3), (0, 4e-3)):
        state[5] = counts * float(host.mock.force_scale[0])
        state = expm(referee.rates(1) * h) @ state
    assert host.mock.drives[0].position == pytest.approx(state[[0, 2]], rel=1e-9)


def test_noise_of_the_force_has_its_rms_and_band_and_its_seed_repeats_it(new_host: New) -> None:
    noise = {"force_noise": {"rms": 0.2, "band": 50.0}}
    paths, forces = [], []
    for seed in (1, 1, 2):
        host = new_host(2, mock=noise | {"seed": seed})
        host.arm()
        own = []
        for n in range(2500):
            host.force(n, [0, 0])
            own.append([float(one.noise_force) for one in host.mock.drives[:2]])
        paths.append(host.bodies["position"].copy())
        forces.append(own)
    assert np.array_equal(paths[0], paths[1])
    assert not np.isclose(paths[0], paths[2]).any()
    value = np.array(forces[0] + forces[2]).T
    assert np.sqrt((value**2).mean()) == pytest.approx(0.2, rel=0.06)
    kept = (value[:, 1:] * value[:, :-1]).mean() / (value**2).mean()
    assert kept == pytest.approx(math.exp(-2 * math.pi * 50.0 * 1e-3), abs=0.04)
    assert abs(np.corrcoef(value)[0, 1]) < 0.1


def test_a_hand_that_grips_is_on_the_handle(new_host: New) -> None:
    host = new_host(1, device={"transmission": BELT}, mock={"grips": [[0.01, 0.4]]})
    path = moved(host, FORCES[:20])[:, 0]
    state = np.eye(8)[7]
    for n, force in enumerate([0.0, *FORCES[:19]]):
        referee = Referee(0.05, 0.15 if n < 10 else 0.35, 2e4, 3.0, 0, 0, 0, 0, 0, 0, 0, 0)
        state[5] = force
        state = expm(referee.rates(1) * 1e-3) @ state
        assert path[n] == pytest.approx(state[[0, 2]], rel=1e-7, abs=1e-12)


def test_channels_may_differ_and_what_is_rigid_stays_as_it_was(new_host: New) -> None:
    each = new_host(2, device={"transmission": BELT | {"motor_mass": [0.05, 0]}, "friction": 1.0})
    rigid = new_host(2, device={"friction": 1.0})
    assert each.mock.called.advance != rigid.mock.called.advance
    path = moved(each, FORCES)
    rigid.arm()
    for n, force in enumerate(FORCES):
        rigid.force(n, [round(force / rigid.mock.force_scale[0])] * 2)
    assert path[-1, 1] == pytest.approx(rigid.bodies["position"][1], rel=1e-12)
    assert abs(path[-1, 0, 0] / path[-1, 1, 0] - 1) > 1e-4


@pytest.mark.parametrize(
    ("device", "mock", "found"),
    [
        ({"transmission": BELT | {"stiffness": 1e12}}, {}, r"in 1/6\.\d+e\+03 of a sample period"),
        ({}, {"force_noise": {"rms": 1, "band": 1e6}}, r"force noise moves it in 1/1e\+04"),
        ({"mass": [[0.2, 0.05], [0.05, 0.3]]}, {"cogging": {"force": 1, "pitch": 1e-3}}, "a mass that is a matrix"),
    ],
)
def test_what_the_mock_cannot_move_is_refused_in_words(new_host: New, device: Any, mock: Any, found: str) -> None:
    with pytest.raises(UsageError, match=found):
        new_host(2 if "mass" in device else 1, device=device, mock=mock)
