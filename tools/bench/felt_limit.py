"""Share of the plane that any controller could render while stable for every mass of a span: by search, not by proof.

    tools/bench/felt_limit [--lags 2] [--grid 12x6] [--json FILE]

`adaptive` knows the present mass of the hand, but has to be stable for every mass of the span: a hand releases the
device sooner than an estimate can follow. The bench shows the cost of that rule for any method. A controller answers
the last two positions and a number of past forces,

    f[n] = -(c0 y[n] + c1 y[n-1]) - (a1 f[n-1] + ... + aN f[n-N])

for a device of one sample of delay, a zero-order hold and no friction. Its c0 and c1 give the slowest pair of poles the
desired stiffness and damping at the hand's mass. The a are searched for the least spectral radius over masses from half
to twice the declared one. A cell of `tools/bench/felt`'s plane counts if that radius is at most 1 and the modulus of
every other pole is at most SLOWEST of the pair's, so that the hand feels the pair.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np
from felt import plane
from numpy.typing import NDArray
from scipy.optimize import minimize

TRUE = (0.5, 0.9, 1.0, 1.1, 2.0)  # of the declared mass
SPAN, MASSES = (0.5, 2.0), 9
SLOWEST = 0.9
TRIES, SEED = 12, 1  # starting points of the search

Floats = NDArray[np.float64]


class Loops:
    """The characteristic polynomials of every controller with so many past forces, around the masses of the span and
    the one that the hand has: affine in c and a. In units of the declared mass, sample periods and metres."""

    def __init__(self, mass: float, lags: int) -> None:
        masses = [mass, *np.geomspace(*SPAN, MASSES)]
        zeros = np.zeros(2 + lags)
        self._rest = np.array([characteristic(one, zeros) for one in masses])
        """(1 + MASSES, degree + 1); the hand's own mass first"""
        units = np.eye(2 + lags)
        self._of_each = (
            np.array([[characteristic(one, unit) for unit in units] for one in masses]) - self._rest[:, None]
        )
        """(1 + MASSES, 2 + lags, degree + 1)"""

    def that_place(self, pair: NDArray[np.complex128], a: Floats) -> Floats | None:
        """The polynomials of the controller with these a that has the pair among the poles of the hand's own mass;
        None where none has."""
        rest = self._rest[0] + a @ self._of_each[0, 2:]
        free, matrix = np.polyval(rest, pair), np.array([np.polyval(one, pair) for one in self._of_each[0, :2]]).T
        if abs(pair[0].imag) > 0.0:  # the other equation is the conjugate one
            free, matrix = np.array([free[0].real, free[0].imag]), np.array([matrix[0].real, matrix[0].imag])
        try:
            c = np.linalg.solve(matrix.real, -free.real)
        except np.linalg.LinAlgError:
            return None
        return np.asarray(self._rest + np.concatenate([c, a]) @ self._of_each)


def characteristic(mass: float, numbers: Floats) -> Floats:
    """Returns the characteristic polynomial of a mass and the controller c0, c1, a1, ..."""
    c, a = numbers[:2], numbers[2:]
    answered = np.convolve(np.append(c, np.zeros(a.size - 1)), [0.5 / mass, 0.5 / mass])  # f made of y, and y of f
    own = np.convolve(np.append(1.0, a), [1.0, -2.0, 1.0, 0.0])
    return np.asarray(own + np.append(np.zeros(own.size - answered.size), answered))


def cost(a: Floats, pair: NDArray[np.complex128], loops: Loops) -> float:
    """The largest spectral radius over the span, and by how much the other poles are too slow."""
    found = loops.that_place(pair, a)
    if found is None:
        return math.inf
    others = list(np.roots(found[0]))
    for pole in pair:
        others.pop(int(np.argmin(np.abs(np.array(others) - pole))))
    too_slow = float(np.abs(others).max()) - SLOWEST * float(np.abs(pair).max())
    return max(float(np.abs(np.roots(one)).max()) for one in found[1:]) + 5.0 * max(too_slow, 0.0)


def can_be_felt(kappa: float, ratio: float, mass: float, loops: Loops, lags: int) -> bool:
    """Returns whether the search finds a controller for a cell: K T²/m and damping ratio, both by the declared mass."""
    pair = np.exp(np.roots([mass, 2.0 * ratio * math.sqrt(kappa), kappa]).astype(complex))
    random = np.random.default_rng(SEED)
    for start in [np.zeros(lags), *random.normal(size=(TRIES - 1, lags)) * 0.6 ** np.arange(lags)]:
        options = {"maxiter": 150 * lags, "xatol": 1e-4, "fatol": 1e-6}
        if minimize(cost, start, args=(pair, loops), method="Nelder-Mead", options=options).fun <= 1.0:
            return True
    return False


def main() -> int:
    parser = argparse.ArgumentParser(
        "tools/bench/felt_limit", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lags", type=int, default=2, help="past forces that the controller knows")
    parser.add_argument("--grid", default="12x6", help="cells along K T²/m and along the damping ratio")
    parser.add_argument("--json", type=Path, help="keep the shares")
    arguments = parser.parse_args()
    columns, rows = (int(number) for number in arguments.grid.split("x"))
    shares = {}
    for mass in TRUE:
        loops, found = Loops(mass, arguments.lags), 0
        for done, (kappa, ratio) in enumerate(plane(columns, rows), 1):
            found += can_be_felt(kappa, ratio, mass, loops, arguments.lags)
            print(f"\rmass × {mass:g}: {done} of {columns * rows} cells  ", end="", file=sys.stderr, flush=True)
        shares[f"{mass:g}"] = found / (columns * rows)
    print(file=sys.stderr)
    print(f"{arguments.lags} past forces: " + ", ".join(f"× {mass} {share:.2f}" for mass, share in shares.items()))
    if arguments.json:
        arguments.json.write_text(json.dumps({"lags": arguments.lags, "shares": shares}) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
