"""What is predicted: of one hand, of one link, of a whole scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from firmware_protocol.wire_time import WireTime
from hapsim.prediction.characteristic import Piece
from hapsim.prediction.correction import Remedies, Rendering
from hapsim.prediction.linear import LinearLink
from hapsim.prediction.timing import WireOf
from hapsim.theory import Configuration, Mode
from hapsim.theory.correction import StatePredictor
from hapsim.theory.network import ContinuousMode


@dataclass(frozen=True)
class Limits:
    """How far K (N/m) and B (N·s/m) on a device are from the stability boundary: worked out when it is asked for, which
    takes longer than all the rest of a prediction."""

    configuration: Configuration
    stiffness: float
    damping: float

    @cached_property
    def stiffness_factor(self) -> float:
        """As of `Felt`."""
        if self.stiffness == 0.0:
            return math.inf
        stiffest = float(self.configuration.stable_stiffness(self.damping)[1])
        return stiffest / self.stiffness if stiffest > 0.0 else 0.0

    @cached_property
    def stable_damping(self) -> tuple[float, float]:
        """As of `Felt`."""
        least, most = (float(value) for value in self.configuration.stable_damping(self.stiffness))
        return least, most


@dataclass(frozen=True)
class Felt:
    """What the hand feels on one device point whose links all end on grounds: a temporary hybrid system of its own."""

    name: str
    channel: int
    configuration: Configuration
    stiffness: float
    """K, N/m, simulated."""
    damping: float
    """B, N·s/m, simulated."""
    k: float
    """k, N/m; NaN where no spring and damper is equivalent."""
    b: float
    """b, N·s/m, real friction included."""
    frequency_hz: float
    damping_ratio: float
    dominant: bool
    stable: bool
    spectral_radius: float
    poles: tuple[complex, ...]
    passive: bool | None
    """Whether no hand can make it unstable (Colgate and Schenkel); None where the condition is not derived."""
    linear_limit: float
    """N/m: the stiffness that the linear rule allows, (b0 + B)/(T/2 + delay T) (Gil et al.)."""
    reason: str
    """Why there is no equivalent, where there is none."""
    limits: Limits
    """How far the stiffness and the damping are from the stability boundary."""
    predictor: StatePredictor | None = None
    """Whose state the force answers, with a correction that predicts."""

    @property
    def stiffness_factor(self) -> float:
        """By how much K could grow before the loop becomes unstable, B as it is; infinity if never, below 1 if it
        is."""
        return self.limits.stiffness_factor

    @property
    def stable_damping(self) -> tuple[float, float]:
        """N·s/m: from least to most B, with K as it is; NaN where no damping makes it stable."""
        return self.limits.stable_damping


RegionKind = Literal["held", "free", "snap"]


@dataclass(frozen=True)
class Region:
    """A region of a hand's travel, and what the hand feels there when it moves by little."""

    piece: Piece
    """Its place, the scene's K and B, and how the links are."""
    felt: Felt
    """What is simulated there, and what it feels like."""
    kind: RegionKind
    """`held` by a spring, `free` without one, or a `snap`: a negative stiffness drives the hand on."""
    is_stable: bool
    """Whether nothing shakes the hand. In a snap: nothing but the snap itself; where it is free: nothing at all."""
    linear: dict[str, LinearLink]
    """The simulated links of the hand there, by name."""
    snap_energy: float
    """J, that a hand gets which pushes through with the force at which the snap begins; 0 where it is none."""
    force: float
    """N, with which a hand at rest at its place pushes towards larger x."""


class Robustness(NamedTuple):
    """What a hand on one device point meets beside k and b."""

    steady_stiffness: float
    """N/m: the stiffness that a steady push meets, the device's own spring included."""
    noise_gain: float
    """N rms of force per m rms of white noise on the positions that are read; infinite where it is unstable."""
    stable_masses: tuple[float, float]
    """kg: the least and the most mass with which the loop is stable; 0 and infinity beyond thirty times the declared
    one. NaN where it is stable with none near that."""


class Desired(NamedTuple):
    """The scene's stiffness and damping at one device point, the device's own included; and how far a correction brings
    the hand there."""

    name: str
    channel: int
    k: float
    """N/m"""
    b: float
    """N·s/m"""
    frequency_hz: float
    damping_ratio: float
    error: float
    """Of what is felt, as `felt_error` counts it; over a span of masses the largest."""
    reached: bool
    remedies: Remedies | None
    """What would make it reachable; None where it is reached, or the mass is a span."""
    stable_masses: tuple[float, float]
    steady_stiffness: float
    """Both as in `Robustness`, of the corrected loop."""


Ranges = tuple[tuple[float, float], ...]
"""Of factors, (from, to)."""


@dataclass(frozen=True)
class LinkMargin:
    """The factors on one link from which the whole scene is unstable, all else as it is.

    Infinity where it never is. Where the scene is unstable as it stands: the largest factor below 1 that makes it
    stable, 0 where there is none. NaN where it was not worked out.
    """

    name: str
    stiffness_factor: float
    damping_factor: float
    stabilizing_stiffness: Ranges | None = None
    """Of an unstable scene: the factors that make it stable, the nearest range below 1 and the nearest above, as far as
    there are any. None where it is stable, or they were not worked out."""
    stabilizing_damping: Ranges | None = None


@dataclass(frozen=True)
class Prediction:
    """A scene, predicted."""

    rate: float
    felt: tuple[Felt, ...]
    """One for each device point that is a temporary hybrid system of its own, in the scene's order."""
    regions: dict[str, tuple[Region, ...]]
    """Of each of these that feels different springs and dampers at different places; `felt` is that of one of them."""
    here: dict[str, Piece]
    """Where each of these is taken to be."""
    coupled: dict[str, str]
    """Device points that are not, and why, in words that follow their name."""
    stable: bool
    """As far as the poles were worked out: see `poles_method`."""
    spectral_radius: float
    poles: tuple[complex, ...]
    """Of the whole closed loop, by decreasing modulus, without those at zero; of a large scene only some."""
    poles_in_all: int
    """How many the closed loop has, those at zero included."""
    poles_method: str
    """In words, which poles of a large scene were worked out; "" where all were."""
    modes: tuple[Mode, ...]
    points: tuple[str, ...]
    """Names to which a mode's participation refers."""
    margins: tuple[LinkMargin, ...]
    """One for each link, in the scene's order; none where they were not asked for."""
    margins_method: str
    """In words, which links of a large scene were worked out, and how surely; "" where all were."""
    wire_time: WireTime
    wire_of: WireOf
    """Whose wire that is."""
    wire_delay: str = ""
    """The delay that was declared and the one that the wire makes of it, for which all this is predicted, in a
    sentence; "" where it adds nothing."""
    assumptions: tuple[str, ...] = ()
    """Sentences: what was taken for what the theory does not have."""
    rendering: Rendering | None = None
    """What is run in place of the scene, where it has a correction: `stiffness` and `damping` of `felt`, poles, modes
    and margins are those of that."""
    desired: tuple[Desired, ...] = ()
    """What the hand is to feel, for the same device points as `felt`; none without a correction."""
    desired_modes: tuple[ContinuousMode, ...] = ()
    """Those of the scene in continuous time, the slowest to decay first; none without a correction."""
    by_its_scheme: bool = True
    """Whether poles, modes and margins are those of the scheme by which the scene runs, or else of CORDIS's."""

    @property
    def region_here(self) -> dict[str, Region]:
        """Of each hand with regions the one where it is taken to be, friction stuck."""
        here = {name: (piece.low, piece.high) for name, piece in self.here.items()}
        every = ((name, one) for name, regions in self.regions.items() for one in reversed(regions))
        return {name: one for name, one in every if (one.piece.low, one.piece.high) == here[name]}

    def asked_for(self, felt: Felt) -> tuple[float, float]:
        """N/m and N·s/m that the scene asks for where `felt` is, the device's own included."""
        wanted = next((one for one in self.desired if one.name == felt.name), None)
        own = felt.configuration
        return (wanted.k, wanted.b) if wanted else (felt.stiffness + own.stiffness, felt.damping + own.friction)

    @property
    def first(self) -> Felt | None:
        """What the hand feels at the scene's first device point that is a system of its own."""
        return self.felt[0] if self.felt else None

    @property
    def k(self) -> float:
        """N/m, of the first; NaN where there is none."""
        return self.first.k if self.first else math.nan

    @property
    def b(self) -> float:
        """N·s/m, of the first; NaN where there is none."""
        return self.first.b if self.first else math.nan

    @property
    def frequency_hz(self) -> float:
        """Eigenfrequency of the first; NaN where there is none."""
        return self.first.frequency_hz if self.first else math.nan

    @property
    def damping_ratio(self) -> float:
        """Of the first; NaN where there is none."""
        return self.first.damping_ratio if self.first else math.nan

    @property
    def dominant(self) -> bool:
        """Whether the first has an equivalent spring and damper."""
        return self.first is not None and self.first.dominant
