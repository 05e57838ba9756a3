"""A hand on one spring and damper: its felt k and b, measured on the mock.

The hand weighs 0.2 kg and has a real friction of 1 N·s/m; K = 2000 N/m and B = 5 N·s/m are simulated, the force is held
(zero-order hold), positions are sampled at the instant. Continuous in time the hand would feel k = K and b = B + 1; the
errors are those of the k and b that `hapsim.measure` identifies. No mass is simulated, so there is no scheme: what
differs is the delay, either one sample, which a higher rate makes shorter, or 1 ms whatever the rate; and, with the
delay of a sample, the correction. The adaptive one knows that the hand weighs between 0.1 and 0.4 kg.
"""

from __future__ import annotations

from typing import Any

from hapsim.errors import DeviceError, GuardError, UsageError
from hapsim.measuring.measure import measure
from hapsim.prediction import predict
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, ViscoElastic
from hapsim.scene.choices import CorrectionName
from hapsim.scene.quantity import Span
from hapsim.speed_accuracy.results import Found

MASS, FRICTION = 0.2, 1.0
STIFFNESS, DAMPING = 2000.0, 5.0
DELAY_S = 1e-3
ONE_SAMPLE, ONE_MILLISECOND = "delay of a sample", "delay of 1 ms"
CORRECTED: dict[str, CorrectionName] = {f"correction: {name}": name for name in ("poles", "predictor", "adaptive")}
SPAN = Span(least=0.1, most=0.4)  # kg

_FLICK = 0.05  # m/s: it swings by half a millimetre, in the range that counts of a picometre have
_QUANTUM = 1e-12
_COARSER = 1e-9  # where the loop follows an estimate: it changes by more than a picometre from push to push


class OneSpring:
    """Its methods are its delays."""

    name = "spring"
    title = "a hand on one spring"
    quantities: tuple[str, ...] = ("k", "b")
    methods: tuple[str, ...] = (ONE_SAMPLE, ONE_MILLISECOND, *CORRECTED)

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """A flicked hand on a wall, with this delay; rate in Hz."""
        correction = CORRECTED.get(method, "none")
        adaptive, numerics = correction == "adaptive", {"precision": precision}
        device = Device(
            clock="lockstep",
            mass=SPAN if adaptive else MASS,
            friction=FRICTION,
            delay=DELAY_S * rate if method == ONE_MILLISECOND else 1.0,
            force_limit=1000.0,
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
        """Measures what the hand feels, in virtual time: k and b, relative; why not, where it cannot."""
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
