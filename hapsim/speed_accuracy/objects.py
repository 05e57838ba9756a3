"""The objects of a comparison: a hand on one spring, a contact, and strings.

**One spring**: what the hand feels, k and b, is measured on the mock. The hand weighs 0.2 kg and has a real friction of
1 N·s/m; K = 2000 N/m and B = 5 N·s/m are simulated, the force is held (zero-order hold), positions are sampled at the
instant. Continuous in time the hand would feel k = K and b = B + 1; the errors are those of the k and b that
`hapsim.measure` identifies. No mass is simulated, so there is no scheme: what differs is the delay, either one sample,
which a higher rate makes shorter, or 1 ms whatever the rate; and, with the delay of a sample, the correction. The
adaptive one knows that the hand weighs between 0.1 and 0.4 kg.

**Contact**: a simulated mass thrown against a buffer on a ground: how long it stays, and how fast it leaves. While it
is below the surface by p, a real contact that never pulls holds m p'' = -max(0, K p + B p'). Thrown with velocity v it
is at p = 0 at the time 0. With w = sqrt(K/m), z = B/(2 sqrt(K m)) the force ends, before the surface is reached again,
when K p + B p' = 0: at

    t = 2 acos(z)/(w sqrt(1 - z²)),      with the velocity e v,      e = exp(-2 z acos(z)/sqrt(1 - z²))

From there the mass flies, and crosses the surface at t + B/K. So its stay below the surface, from the straight line on
which it came to that on which it leaves, both exact whatever the samples, and its restitution e give K and B: z from
-ln e, then w from the stay. `found` reads both lines from the samples, takes the k and b that would have the same stay
and restitution in continuous time, and says how far they are off: the root mean square over several phases of arrival
between two samples.

**String**: masses in a row with a hand on one of them: where its first modes ring. It weighs 5 g and rings at 20 Hz
with a damping ratio of 1e-4; its ends are fixed. The error is that of the frequency of modes 1 to 5, the worst of them,
identified from the run of each mode by itself. For these runs the hand's link has neither stiffness nor damping; for
the time that a tick takes, a hundredth of a link's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst
from scipy.optimize import brentq

from hapsim.cordis.offline import start, ticks_watched
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.schemes.exact import ExactModes
from hapsim.errors import DeviceError, GuardError, UsageError
from hapsim.measuring.measure import measure_on_line as measure
from hapsim.prediction import predict
from hapsim.scene import Buffer, Device, DevicePoint, Ground, Initial, Mass, Mock, Scene, String, ViscoElastic
from hapsim.scene.choices import SENSORS, CorrectionName
from hapsim.scene.values import Span
from hapsim.speed_accuracy.results import Found, Object
from hapsim.speed_accuracy.strings import STEADY, StringOfMasses, Vector, frequencies_of, hand_link, held_mass

MASS, FRICTION = 0.2, 1.0
STIFFNESS, DAMPING = 2000.0, 5.0
DELAY_S = 1e-3
ONE_SAMPLE, ONE_MILLISECOND = "delay of a sample", "delay of 1 ms"
CORRECTED: dict[str, CorrectionName] = {
    f"correction: {name}": name for name in ("poles", "predictor", "adaptive", "sensed")
}
SPAN = Span(least=0.1, most=0.4)  # kg

_FLICK = 0.05  # m/s: it swings by half a millimetre, in the range that counts of a picometre have
_QUANTUM = 1e-12
_COARSER = 1e-9  # where the loop follows an estimate: it changes by more than a picometre from push to push


class OneSpring:
    """A hand on one spring. Its methods are delays and corrections."""

    name = "spring"
    title = "a hand on one spring"
    quantities: tuple[str, ...] = ("k", "b")
    methods: tuple[str, ...] = (ONE_SAMPLE, ONE_MILLISECOND, *CORRECTED)

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """Returns a scene of a flicked hand on a wall, with this delay; rate in Hz."""
        correction = CORRECTED.get(method, "none")
        adaptive, numerics = correction == "adaptive", {"precision": precision}
        device = Device(
            clock="lockstep",
            mass=SPAN if adaptive else MASS,
            friction=FRICTION,
            delay=DELAY_S * rate if method == ONE_MILLISECOND else 1.0,
            force_limit=1000.0,
            sensors=SENSORS if correction == "sensed" else (),
            correction=correction,
        )
        modules: dict[str, Any] = {
            "hand": DevicePoint(channel=0),
            "wall": Ground(),
            "touch": ViscoElastic(between=("hand", "wall"), stiffness=STIFFNESS, damping=DAMPING),
        }
        mock = Mock(mass=MASS, initial=Initial(velocity=_FLICK), quantum=_COARSER if adaptive else _QUANTUM)
        return Scene(version=1, rate=rate, device=device, mock=mock, modules=modules, **numerics)  # type: ignore[arg-type]

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Measures the felt k and b in virtual time. Returns their relative errors, or why there are none."""
        scene = self.scene(method, precision, rate)
        predicted = predict(scene, with_margins=False)
        felt = predicted.felt[0]
        if not predicted.stable:
            return Found({}, "unstable, as predicted")
        if not felt.dominant:
            return Found({}, f"as predicted, no spring and damper is equivalent: {felt.reason}")
        try:
            measured = measure(scene)
            if measured.failure is not None:
                raise measured.failure
        except (UsageError, DeviceError, GuardError) as error:
            return Found({}, str(error))
        if not measured.dominant:
            return Found({}, f"no spring and damper was identified: {measured.reason}")
        return Found({"k": measured.k / STIFFNESS - 1.0, "b": measured.b / (DAMPING + FRICTION) - 1.0})


BALL = 0.02  # kg
BUFFER_STIFFNESS, BUFFER_DAMPING = 8000.0, 0.85  # N/m, N·s/m
THROWN = 1.0  # m/s
PHASES = 8

_STAYS = 6.0  # of the continuous one: a mass that is below for longer does not leave
_SO_HEAVY = 1e9  # kg: it stays where it is


class Contact:
    """A mass that bounces on a buffer for 5 ms, with a restitution of 0.9."""

    name = "contact"
    title = "a mass thrown against a buffer"
    quantities: tuple[str, ...] = ("k", "b")
    methods: tuple[str, ...] = tuple(SCHEMES)

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """Returns a scene with a mass so heavy that it always touches the buffer, the costlier of two cases."""
        return _ball_scene(method, precision, rate, Mass(mass=_SO_HEAVY, position=-1e-3))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Throws the mass at the surface PHASES times, each a part of a sample later: rms of k and b, relative."""
        pairs = []
        for i in range(PHASES):
            stay, restitution = _thrown(method, precision, rate, (i + 0.5) / PHASES)
            if not (math.isfinite(stay) and 0.0 < restitution < math.inf):
                return Found({}, "the mass did not leave again, or faster and faster")
            pairs.append(contact_felt(stay, restitution))
        if not np.isfinite(pairs).all():
            return Found({}, "no spring and damper throws back so little")
        k, b = np.transpose(pairs)
        off_k, off_b = (
            float(np.sqrt(np.mean(off**2))) for off in (k / BUFFER_STIFFNESS - 1.0, b / BUFFER_DAMPING - 1.0)
        )
        return Found({"k": off_k, "b": off_b})


def contact_of(k: float, b: float) -> tuple[float, float]:
    """(stay below the surface in s, restitution) of the continuous contact, z < 1; a negative b throws back faster."""
    z = b / (2.0 * math.sqrt(k * BALL))
    angle = math.acos(z) / math.sqrt(1.0 - z * z)
    return math.sqrt(BALL / k) * (2.0 * angle + 2.0 * z), math.exp(-2.0 * z * angle)


def contact_felt(stay: float, restitution: float) -> tuple[float, float]:
    """(k, b) of the continuous contact with this stay and restitution. NaN where there is none."""
    lost = -math.log(restitution)
    most = 1.0 - 1e-9

    def beyond(z: float) -> float:
        return 2.0 * z * math.acos(z) / math.sqrt(1.0 - z * z) - lost

    if not beyond(-most) < 0.0 < beyond(most):
        return math.nan, math.nan
    z = float(brentq(beyond, -most, most, xtol=1e-16, rtol=1e-14))
    w = 2.0 * (math.acos(z) / math.sqrt(1.0 - z * z) + z) / stay
    return BALL * w * w, 2.0 * z * BALL * w


def _thrown(method: str, precision: str, rate: float, phase: float) -> tuple[float, float]:
    """(stay, restitution) of a mass that reaches the surface `phase` of a sample period after a sample."""
    above = (2.0 + phase) * THROWN / rate
    scene = _ball_scene(method, precision, rate, Mass(mass=BALL, position=above, velocity=-THROWN))
    program, ball = compile_scene(scene), numbers_of(scene)["ball"]
    start(program, np.zeros(scene.channels))
    watched = np.empty(math.ceil(_STAYS * contact_of(BUFFER_STIFFNESS, BUFFER_DAMPING)[0] * rate) + 8)
    ticks_watched(program, [row[ball:] for row in program.rows], np.ones(1), watched)
    return stay_of([above, *watched], rate)


def stay_of(positions: Sequence[float] | NDArray[np.float64], rate: float) -> tuple[float, float]:
    """(stay in s, restitution) from the lines of flight through the first two and the last two positions."""
    x = np.asarray(positions)
    came, left = x[1] - x[0], x[-1] - x[-2]
    if not (np.isfinite(x).all() and came < 0.0 < left and x[-2] > 0.0):
        return math.nan, math.nan
    arrival = -x[0] / came
    departure = x.size - 1 - x[-1] / left
    return float((departure - arrival) / rate), float(-left / came)


def _ball_scene(method: str, precision: str, rate: float, ball: Mass) -> Scene:
    modules = {
        "hand": DevicePoint(channel=0),
        "floor": Ground(),
        "ball": ball,
        "bounce": Buffer(between=("ball", "floor"), stiffness=BUFFER_STIFFNESS, damping=BUFFER_DAMPING),
    }
    return _scene(method, precision, rate, modules)


MODES = (1, 2, 3, 4, 5)
_STEADY_IN_SINGLE = 1.0 + 1e-4


class RingingString:
    """A string of masses, with its name and title."""

    quantities: tuple[str, ...] = ("frequency",)
    methods: tuple[str, ...] = tuple(SCHEMES)

    def __init__(self, name: str, title: str, string: StringOfMasses) -> None:
        self.name, self.title, self.string = name, title, string

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """Returns the string with a hand's link, simulated by `method` at `rate` (Hz)."""
        return scene_of(self.string, method, precision, rate, *hand_link(self.string))

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Simulates free motions in several modes. Returns the largest relative error of a frequency."""
        steady = STEADY if precision == "double" else _STEADY_IN_SINGLE
        ring = partial(record, scene_of(self.string, method, precision, rate), self.string)
        rung = frequencies_of(ring, self.string, rate, MODES, steady=steady)
        errors = [frequency / self.string.frequency(mode) - 1.0 for mode, frequency in zip(MODES, rung, strict=True)]
        if not all(math.isfinite(error) for error in errors):
            return Found({}, "unstable")
        return Found({"frequency": max(errors, key=abs)})


def scene_of(
    string: StringOfMasses, method: str, precision: str, rate: float, stiffness: float = 0.0, damping: float = 0.0
) -> Scene:
    """Returns the string as a scene; the hand's link in N/m and N·s/m."""
    ends = ("hand", f"string.{held_mass(string)}")
    modules = {
        "hand": DevicePoint(channel=0),
        "string": String(**asdict(string)),
        "touch": ViscoElastic(between=ends, stiffness=stiffness, damping=damping),
    }
    return _scene(method, precision, rate, modules)


def record(scene: Scene, string: StringOfMasses, shape: Vector, samples: int) -> Vector:
    """Returns the motion (samples,) along `shape` (N,), after the scene's string was released in that shape."""
    program = compile_scene(scene)
    # It is kept as positions of its masses in the row whose turn it is; or, by the exact scheme, as how much there is
    # of each of its modes: sines, all of one norm, the slowest first.
    modes = next((part.numbers for part in program.parts if isinstance(part.numbers, ExactModes)), None)
    if modes is not None:
        rows, amounts = 2 * [modes.position], dst(shape, type=1) / (shape.size + 1)
    else:
        first = numbers_of(scene)["string.0"]
        rows, amounts = [row[first:] for row in program.rows], shape
    for row in rows:
        row[: string.masses] = amounts
    start(program, np.zeros(scene.channels))
    watched = np.empty(samples)
    ticks_watched(program, rows, amounts / (amounts @ amounts), watched)
    return watched


def _scene(method: str, precision: str, rate: float, modules: dict[str, Any]) -> Scene:
    numerics: Any = {"scheme": method, "precision": precision}
    return Scene(version=1, rate=rate, device=Device(clock="lockstep", mass=0.2), modules=modules, **numerics)


SHARP = 0.2  # by which bending raises mode 5

OBJECTS: tuple[Object, ...] = (
    OneSpring(),
    Contact(),
    RingingString("string-10", "a string of 10 masses", StringOfMasses.tuned(10)),
    RingingString("string-100", "a string of 100 masses", StringOfMasses.tuned(100)),
    RingingString("string-1000", "a string of 1000 masses", StringOfMasses.tuned(1000)),
    RingingString("stiff-string-100", "a stiff string of 100 masses", StringOfMasses.tuned(100, sharp=SHARP)),
)
"""A new one is a class above and a line here."""
