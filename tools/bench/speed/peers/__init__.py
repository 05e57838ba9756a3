"""Other simulators of a string of masses and visco-elastic links, one peer per file.

C stencil, alone and with a hand    `c_stencil.py`. Written for this string and no other. Wants a C compiler, `cc`.
C network                           `c_network.py`. Any network, links by their ends' numbers, a hand among its points.
C spring                            `c_spring.py`. Not a string: a hand on one spring, the smallest tick there is.
Faust mi.lib, alone and with a hand `faust_mi.py`. Mass-interaction models of the CORDIS family, compiled to one
                                    straight run of code. Debian: `apt install faust g++`. Its compiler is given 120 s,
                                    and so is the one behind it.
MuJoCo Euler, implicitfast, RK4     `mujoco_tendons.py`. A physics engine for robots: slide joints, and tendons with
                                    stiffness and damping between neighbours; what it can do besides is switched off.
                                    `pip install mujoco` into an environment of its own, and name that one's Python in
                                    HAPSIM_PEERS_PYTHON; without it, the Python that runs this is asked.
SciPy DOP853, LSODA                 `scipy_ivp.py`. General solvers that choose their own steps; nothing to install.

    PYTHONPATH=. HAPSIM_PEERS_PYTHON=/path/to/venv/bin/python python -m speed.peers --string 100 --rate 10000 --json

(from tools/bench). C, Faust and MuJoCo's integrators step at the rate; SciPy's answer at it. The C programs and
mi.lib share one scheme, centred with a damper by backward difference, so that they ring at the same frequencies.
"""

from __future__ import annotations

from speed.peers.c_network import CNetwork
from speed.peers.c_stencil import CStencil
from speed.peers.faust_mi import FaustMi
from speed.peers.mujoco_tendons import INTEGRATORS, MuJoCo
from speed.peers.peer import Peer
from speed.peers.scipy_ivp import METHODS, SciPy


def every_peer() -> list[Peer]:
    """A new one of each; whether it is `available` on this machine, it tells itself."""
    return [
        CStencil(),
        CStencil(hand=True),
        CNetwork(),
        FaustMi(),
        FaustMi(hand=True),
        *(MuJoCo(integrator) for integrator in INTEGRATORS),
        *(SciPy(method) for method in METHODS),
    ]
