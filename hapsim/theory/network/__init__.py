"""Closed loop of any linear scene: hands, masses and links together."""

from hapsim.theory.network.felt import (
    UNLIKE,
    ContinuousMode,
    Direction,
    FeltPair,
    continuous_mass,
    continuous_modes,
    continuous_pair,
    drift_damping,
    felt_mass,
    felt_pair,
    no_pair,
    principal,
)
from hapsim.theory.network.impedance import steady_stiffness
from hapsim.theory.network.large_modes import solve
from hapsim.theory.network.margins import Margin, Margins, Stabilizing, margins_of
from hapsim.theory.network.modes import SURELY, Mode, Solution, poles_of
from hapsim.theory.network.network import (
    Network,
    part_of,
    part_of_each,
    parts_of,
    proves_stability,
    without_observers,
)
from hapsim.theory.sample import LARGE, is_large, loop, state_size
from hapsim.theory.schemes import NotWorkedOutError
