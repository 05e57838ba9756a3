"""Fits a psychometric function to the answers of run_trials.py, and draws it.

    hapsim export answers.trace trials.tsv
    hapsim export answers.trace events.tsv
    python fit.py trials.tsv events.tsv discrimination.png

The share of answers "stiffer" is Φ(a + b ln(K/N/m)): half of them at the point of subjective equality, 75 % where a
spring is stiffer by the just noticeable difference. Intervals of 95 % come from the Fisher information.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

Numbers = NDArray[np.float64]
QUARTILE, WIDTH = 0.6745, 1.96  # of a normal distribution: where it has 75 %, and 97.5 %
MOST_STEPS = 100


class Fit(NamedTuple):
    """A fitted psychometric function."""

    a: float
    b: float
    covariance: Numbers
    """(2, 2) of a and b."""

    def share(self, stiffness: Numbers, errors: float = 0.0) -> Numbers:
        """Returns the share of answers "stiffer", shifted by this number of standard errors."""
        x = np.stack([np.ones_like(stiffness), np.log(stiffness)])
        deviation = np.sqrt(np.einsum("ik,ij,jk->k", x, self.covariance, x))
        return np.asarray(norm.cdf(self.a + self.b * x[1] + errors * deviation))

    def equality(self) -> tuple[float, float, float]:
        """Returns the point of subjective equality, N/m, and the ends of its interval."""
        slope = np.array([-1.0, self.a / self.b]) / self.b  # of -a/b
        error, middle = WIDTH * np.sqrt(slope @ self.covariance @ slope), -self.a / self.b
        return tuple(float(np.exp(middle + side * error)) for side in (0, -1, 1))  # type: ignore[return-value]

    def jnd(self) -> tuple[float, float, float]:
        """Returns the just noticeable difference, as a share, and the ends of its interval."""
        error = WIDTH * np.sqrt(self.covariance[1, 1])
        slopes = (self.b, self.b + error, max(self.b - error, 1e-3))
        return tuple(float(np.expm1(QUARTILE / slope)) for slope in slopes)  # type: ignore[return-value]


def answers(trials: Path, events: Path) -> tuple[Numbers, Numbers]:
    """Returns the stiffness of each answered trial, N/m, and its answer, 1 for stiffer."""
    stiffness, found = {one["trial"]: float(one["touch.stiffness"]) for one in rows(trials)}, list[tuple[float, int]]()
    trial = ""
    for one in rows(events):
        if one["trial_type"] == "trial":
            trial = one["value"]
        elif one["trial_type"] == "marker" and one["value"].startswith("answer ") and trial:
            found.append((stiffness[trial], int(one["value"].removeprefix("answer "))))
    if len({answer for _, answer in found}) < 2:
        raise SystemExit(f"fit.py: found {len(found)} answers of one kind, expected both: no function can be fitted")
    return np.array(found).T[0], np.array(found).T[1]


def rows(path: Path) -> list[dict[str, str]]:
    """Returns the lines of a table, by column."""
    with path.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text, delimiter="\t"))


def fitted(stiffness: Numbers, answer: Numbers) -> Fit:
    """Returns the most likely function, by Fisher scoring."""
    softer, stiffer = stiffness[answer == 0], stiffness[answer == 1]
    if softer.max() <= stiffer.min() or stiffer.max() <= softer.min():  # then any steeper function is more likely
        raise SystemExit("fit.py: all answers change at one stiffness: add conditions near it, or more repetitions")
    centre = np.log(stiffness).mean()
    x, of = np.stack([np.ones_like(stiffness), np.log(stiffness) - centre]), np.zeros(2)
    for _ in range(MOST_STEPS):
        share, density = norm.cdf(of @ x).clip(1e-9, 1 - 1e-9), norm.pdf(of @ x)
        weight = density**2 / (share * (1.0 - share))
        information = (x * weight) @ x.T
        step = np.linalg.solve(information, x @ (density * (answer - share) / (share * (1.0 - share))))
        of += step
        if np.abs(step).max() < 1e-9:
            break
    else:
        raise SystemExit("fit.py: found no function that fits, expected answers that depend on the stiffness")
    back = np.array([[1.0, -centre], [0.0, 1.0]])  # to ln(K) without its mean
    a, b = (back @ of).tolist()
    return Fit(a, b, back @ np.linalg.inv(information) @ back.T)


def draw(stiffness: Numbers, answer: Numbers, fit: Fit, out: Path) -> None:
    """Draws answers and function."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
    grid = np.linspace(0.95 * stiffness.min(), 1.05 * stiffness.max(), 200)
    axes.fill_between(grid, fit.share(grid, -WIDTH), fit.share(grid, WIDTH), color="#1f77b4", alpha=0.15, linewidth=0)
    axes.plot(grid, fit.share(grid), color="#1f77b4", label="fit, with its interval of 95 %")
    levels = np.unique(stiffness)
    shares = [answer[stiffness == level].mean() for level in levels]
    axes.plot(levels, shares, "o", color="black", label=f"{stiffness.size} answers")
    axes.axvline(fit.equality()[0], color="0.5", linestyle="--", linewidth=1.0, label="point of subjective equality")
    axes.set(xlabel="Stiffness (N/m)", ylabel='Share of answers "stiffer"', ylim=(-0.03, 1.03))
    axes.legend(frameon=False, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(out, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trials", type=Path)
    parser.add_argument("events", type=Path)
    parser.add_argument("picture", type=Path)
    options = parser.parse_args()
    stiffness, answer = answers(options.trials, options.events)
    fit = fitted(stiffness, answer)
    draw(stiffness, answer, fit, options.picture)
    middle, low, high = fit.equality()
    print(f"Point of subjective equality: {middle:.0f} N/m ({low:.0f} to {high:.0f})")
    share, least, most = (100.0 * one for one in fit.jnd())
    print(f"Just noticeable difference: {share:.1f} % ({least:.1f} to {most:.1f})")


if __name__ == "__main__":
    main()
