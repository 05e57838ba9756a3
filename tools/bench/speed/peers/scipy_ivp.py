"""SciPy's general solvers, which choose their own steps and answer at the rate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import StringOfMasses, cost_of, frequencies_of, project

METHODS = ("DOP853", "LSODA")
_TOLERANCE = 1e-9  # of a displacement as it is, and of the largest one at the begin


class SciPy:
    """`solve_ivp` by `method` with a tolerance of 1e-9, relative and to the largest displacement."""

    precision = "double"

    def __init__(self, method: str) -> None:
        self._method = method
        self.name = f"SciPy {method}"
        self.preparation_s: float | None = None
        self.note = "chooses its own steps, tolerance 1e-9"

    def available(self) -> str:
        return "" if find_spec("scipy") else "There is no module scipy."

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        """Measures from a pluck, which excites every mode."""
        start = string.plucked()
        return cost_of(lambda samples: self._run(string, rate, start, samples), rate, rounds)

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        def record(shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
            return self._run(string, rate, shape, samples, lambda rows: project(rows, shape))

        return frequencies_of(record, string, rate, modes, explicit=False)

    def _run(
        self,
        string: StringOfMasses,
        rate: float,
        start: NDArray[np.float64],
        samples: int,
        see: Callable[[NDArray[np.float64]], NDArray[np.float64]] = lambda rows: rows[:, 0],
    ) -> NDArray[np.float64]:
        """Returns `see` of the displacements (samples + 1, N), from rest in `start`."""
        from scipy.integrate import solve_ivp

        solution = solve_ivp(
            _derivative(string),
            (0.0, samples / rate),
            np.stack([start, np.zeros_like(start)], axis=1).ravel(),
            method=self._method,
            t_eval=np.arange(samples + 1) / rate,
            rtol=_TOLERANCE,
            atol=_TOLERANCE * float(np.max(np.abs(start))),
            **self._options(string.masses),
        )
        return see(solution.y[0::2].T)

    def _options(self, masses: int) -> dict[str, Any]:
        """Returns the solver's options: the Jacobian's bands, for a solver that may need them."""
        return {"lband": min(3, 2 * masses - 1), "uband": min(2, 2 * masses - 1)} if self._method == "LSODA" else {}


def _derivative(string: StringOfMasses) -> Callable[[float, NDArray[np.float64]], NDArray[np.float64]]:
    """Returns the derivative of the state x_1, v_1, x_2, v_2 ..., by one second difference of K x + B v."""
    per_mass = (string.stiffness / string.mass, string.damping / string.mass)
    pull = np.zeros(string.masses + 2)

    def derivative(_time: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        pairs = state.reshape(-1, 2)
        change = np.empty_like(pairs)
        change[:, 0] = pairs[:, 1]
        np.dot(pairs, per_mass, out=pull[1:-1])
        change[:, 1] = pull[2:] - 2.0 * pull[1:-1] + pull[:-2]
        return change.ravel()

    return derivative
