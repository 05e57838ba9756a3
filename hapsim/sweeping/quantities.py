"""The quantities of a sweep at each point: predictions, measurements on the mock, impedances, a function's numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import HapsimError, UsageError
from hapsim.measuring.measure import measure
from hapsim.measuring.measure_impedance import measure_impedance
from hapsim.measuring.periodic_excitation import lines_for
from hapsim.one_thread import one_thread
from hapsim.prediction import predict_impedance
from hapsim.prediction.predict import prediction_of
from hapsim.prediction.prediction import Place, Prediction
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene
from hapsim.scene.varied import Value, Varied
from hapsim.theory.network.felt import Tie

ERROR = "error"
"""The variable that holds, for each point, why a value failed or is missing."""
FREQUENCY = "frequency_hz"
"""The dimension of impedances."""

Values = dict[str, Any]


class Variable(NamedTuple):
    """One number of each point."""

    unit: str
    description: str
    of: Callable[[Any], float] = lambda _: math.nan

    def called(self, how: str) -> Variable:
        """Returns the variable with the word `how` before its description."""
        return self._replace(description=f"{how} {self.description}")


_FELT = {
    "k": Variable("N/m", "stiffness that the hand feels", lambda one: one.k),
    "b": Variable("N·s/m", "damping that the hand feels, real friction included", lambda one: one.b),
    "frequency_hz": Variable("Hz", "eigenfrequency", lambda one: one.frequency_hz),
    "damping_ratio": Variable("", "damping ratio", lambda one: one.damping_ratio),
}
_PASSIVE = {
    "passive": Variable("", "1: no hand makes it unstable; 0: some do"),
    "needed_friction": Variable("N·s/m", "friction from which on no hand makes it unstable"),
}
_OF_HAND = {f"predicted_{name}": one.called("predicted") for name, one in _FELT.items()}
_OF_SCENE = {
    "stable": Variable("", "1: predicted stable; 0: unstable", lambda one: _truth(one.stable)),
    "contact_states": Variable("", "states found that its contacts can be in", lambda one: float(one.states.count)),
    "unstable_states": Variable("", "motions that grow in these", lambda one: float(len(one.states.growing))),
    "spectral_radius": Variable(
        "", "largest modulus of a predicted pole; 1 where something moves freely", lambda one: one.spectral_radius
    ),
}
_MEASURED = {f"measured_{name}": one.called("measured") for name, one in _FELT.items()} | {
    "measured_k_uncertainty": Variable("N/m", "standard uncertainty of measured_k", lambda one: one.k_uncertainty),
    "measured_b_uncertainty": Variable("N·s/m", "standard uncertainty of measured_b", lambda one: one.b_uncertainty),
    "residual": Variable("m", "standard deviation of what the fit leaves of the position", lambda one: one.residual_m),
}
_IMPEDANCE = {
    f"{how}_impedance_{part}": Variable("N·s/m", f"{name} part of the impedance that the scene renders, {how}")
    for how in ("predicted", "measured")
    for part, name in (("re", "real"), ("im", "imaginary"))
}
KINDS = {"predicted": _OF_HAND | _PASSIVE | _OF_SCENE, "measured": _MEASURED, "impedance": _IMPEDANCE}
"""The variables of each kind of quantity, by name."""

_RANKS = {1: "stiffer", 2: "softer"}
_ALONG = {
    "k_{}": _FELT["k"],
    "b_{}": _FELT["b"],
    "angle_{}": Variable("°", "angle from x towards y", lambda one: one.angle_deg),
}
_UNCERTAIN = {f"{one}_{{}}_uncertainty": _MEASURED[f"measured_{one}_uncertainty"] for one in "kb"}
_IN_PLANE = KINDS | {
    how: {
        f"{how}_{name.format(rank)}": one._replace(description=f"{one.description}: {how}, {word} direction")
        for rank, word in _RANKS.items()
        for name, one in variables.items()
    }
    for how, variables in (("predicted", _ALONG), ("measured", _ALONG | _UNCERTAIN))
}
_IN_PLANE["predicted"] |= {name: _OF_SCENE[name] for name in ("stable", "spectral_radius")}


_FELT_MASS = {
    "m": Variable("kg", "mass that the hand feels", lambda one: one.m),
    "b": Variable("N·s/m", "damping that the hand feels", lambda one: one.b),
}
_IN_ADMITTANCE = {
    "predicted": {f"predicted_{name}": one.called("predicted") for name, one in _FELT_MASS.items()} | _OF_SCENE,
    "measured": {f"measured_{name}": one.called("measured") for name, one in _FELT_MASS.items()}
    | {
        "measured_m_uncertainty": Variable("kg", "standard uncertainty of measured_m", lambda one: one.m_uncertainty),
        "measured_b_uncertainty": _MEASURED["measured_b_uncertainty"],
        "residual": _MEASURED["residual"]._replace(of=lambda one: one.motion.residual_m),
    },
    "impedance": _IMPEDANCE,
}  # fmt: skip
_OVER_PHASES = {
    f"predicted_{name}_{end}": one._replace(description=f"{end} {one.description}, over all phases of the clocks")
    for name, one in _FELT.items()
    if name in ("k", "b")
    for end in ("least", "most")
}
_OF_DEVICES = {"predicted": _OVER_PHASES | {name: _OF_SCENE[name] for name in ("stable", "spectral_radius")}}


def kinds_of(scene: Scene) -> dict[str, dict[str, Variable]]:
    """Returns `KINDS` of a scene; in the plane the variables are those of two principal directions, of several devices
    the predicted ones of the first hands that links tie across them, in admittance those of a mass and a damping."""
    if scene.ports:
        return _OF_DEVICES
    if scene.device.is_admittance:
        return _IN_ADMITTANCE
    return KINDS if scene.space == 1 else _IN_PLANE


@dataclass(frozen=True)
class Task:
    """The quantities to compute at each point."""

    document: dict[str, Any]  # the scene
    kinds: tuple[str, ...]  # of KINDS
    channel: int = 0
    place: Place = None  # of the hand, m or rad, in the plane (x, y); None: where it rests, or starts
    duration: float | None = None  # of each measurement, s; None: the default of `measure`
    function: Callable[[Scene], Mapping[str, float]] | None = None
    """Computes further numbers of a scene, by name."""

    def at(self, scene: Scene) -> tuple[Values, str]:
        """Returns the numbers of one scene by name, and why some are missing ("" if none is)."""
        found: Values = {}
        failures: list[str] = []
        for kind, work in (*((kind, _WORK[kind]) for kind in self.kinds), ("function", _by_function)):
            try:
                values, reason = work(self, scene)
                found |= values
                failures += [f"{kind}: {reason}"] if reason else []
            except HapsimError as error:
                failures.append(f"{kind}: {error}")
            except Exception as error:  # a user's function, or a defect: neither may end thousands of points
                failures.append(f"{kind}: {type(error).__name__}: {error}")
        for one in (f"angle_{rank}" for rank in _RANKS):
            if {f"predicted_{one}", f"measured_{one}"} <= found.keys():  # 179.9° is -0.1°
                turned = found[f"measured_{one}"] - found[f"predicted_{one}"]
                found[f"measured_{one}"] -= 180.0 * round(turned / 180.0)
        return found, "; ".join(failures)


def _predicted(task: Task, scene: Scene) -> tuple[Values, str]:
    prediction, variables = prediction_of(scene, task.place, with_margins=False), kinds_of(scene)["predicted"]
    found = {name: one.of(prediction) for name, one in _OF_SCENE.items() if name in variables}
    if scene.ports:
        values, reason = _over_phases(prediction)
        return found | values, reason
    if (part := prediction.part_on(task.channel)) is None:
        return found, ""
    if part.is_admittance:
        felt = part.felt_masses[part.channels.index(task.channel)]
        of_mass = {name: one.of(felt) for name, one in variables.items() if name not in _OF_SCENE}
        return of_mass | found, f"no mass and damping: {felt.reason}" if felt.reason else ""
    if _PASSIVE.keys() <= variables.keys():
        needed = float(part.needed_friction[part.channels.index(task.channel)])
        found |= {"passive": _truth(part.passive), "needed_friction": needed}
    if "predicted_k_1" in variables:
        return found | _along("predicted", _ALONG, part.along(scene.hand_on(task.channel))), part.felt.reason
    if (own := part.own_motion) is None:
        return found, f"no single k and b: {part.felt.reason or 'several hands'}"
    reason = "" if part.alone is None else part.alone.reason
    return {name: one.of(own) for name, one in _OF_HAND.items()} | found, reason


def _over_phases(prediction: Prediction) -> tuple[Values, str]:
    """Returns the least and the most k and b of the first part across devices: between two hands, on their reduced
    mass; else of its first hand."""
    felt = next((found for part in prediction.parts if (found := part.over_phases)), None)
    if felt is None:
        return {}, "no link ties two devices"
    ends = felt.tie or [Tie(float(k[0, 0]), float(b[0, 0]), math.nan) for k, b in zip(felt.k, felt.b, strict=True)]
    each = zip(("least", "most"), ends, strict=True)
    return {f"predicted_{name}_{end}": getattr(one, name) for end, one in each for name in "kb"}, felt.reason


def _along(how: str, variables: Mapping[str, Variable], directions: Iterable[object]) -> Values:
    return {
        f"{how}_{name.format(rank)}": one.of(direction)
        for rank, direction in enumerate(directions, 1)
        for name, one in variables.items()
    }


def _measured(task: Task, scene: Scene) -> tuple[Values, str]:
    measurement = measure(scene, channel=task.channel, at=task.place, duration=task.duration, run=run_in_memory)
    if "measured_k_1" in (variables := kinds_of(scene)["measured"]):
        return _along("measured", _ALONG | _UNCERTAIN, measurement.principal), ""
    return {name: one.of(measurement) for name, one in variables.items()}, measurement.reason


def _impedances(task: Task, scene: Scene) -> tuple[Values, str]:
    measured = measure_impedance(scene, duration=task.duration, run=run_in_memory)
    predicted = predict_impedance(scene, measured.frequency, as_read=True)
    at = measured.channels.index(task.channel)
    found: Values = {}
    for how, impedance in (("predicted", predicted.rendered), ("measured", measured.rendered.value)):
        found[f"{how}_impedance_re"] = impedance[:, at, at].real
        found[f"{how}_impedance_im"] = impedance[:, at, at].imag
    return found, ""


def _by_function(task: Task, scene: Scene) -> tuple[Values, str]:
    found = {} if task.function is None else {name: float(one) for name, one in task.function(scene).items()}
    if taken := found.keys() & {ERROR, FREQUENCY, *(name for kind in kinds_of(scene).values() for name in kind)}:
        raise UsageError(f"the function returns {min(taken)}, a name that sweeps use: expected another")
    return found, ""


_KEPT_BYTES = 1 << 24
"""Once a block of this size was freed, glibc keeps freed memory up to it. Otherwise the arrays of a measurement, of a
megabyte each, get new pages from the system every time: a tenth of its processor time."""
_WORK: dict[str, Callable[[Task, Scene], tuple[Values, str]]] = {
    "predicted": _predicted,
    "measured": _measured,
    "impedance": _impedances,
}


def frequencies(task: Task) -> NDArray[np.float64]:
    """Returns the frequencies (n,) in Hz of the task's impedances."""
    return lines_for(float(task.document["rate"])).frequency


def work(task: Task, points: Sequence[Mapping[str, Value]]) -> dict[str, NDArray[Any]]:
    """Returns the numbers of these points by name, and ERROR. Arrays are (n,), those of impedances (n, f); a missing
    number is NaN. The results have the same bits however the points are batched, and on every worker."""
    varied, found, errors = Varied(Scene.model_validate(task.document)), [], []
    np.empty(_KEPT_BYTES, np.uint8)
    with one_thread():
        for values in points:
            try:
                numbers, error = task.at(varied.scene(values))
            except HapsimError as failure:
                numbers, error = {}, str(failure)
            found.append(numbers)
            errors.append(error)
    names = dict.fromkeys(name for numbers in found for name in numbers)
    none = {name: np.full(frequencies(task).size, np.nan) if name in _IMPEDANCE else np.nan for name in names}
    columns = {name: np.array([numbers.get(name, none[name]) for numbers in found], float) for name in names}
    return columns | {ERROR: np.array(errors)}


def _truth(value: bool | None) -> float:
    return math.nan if value is None else float(value)
