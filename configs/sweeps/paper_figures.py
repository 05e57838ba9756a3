"""The paper's deformed planes, measured: what 10 000 simulated springs and dampers of each case feel like on the mock.

    python paper_figures.py [--points 100] [--jobs 2]

The three cases of Florens, Voda and Urma, §6 (their Figures 7 to 9): force impulses without delay, with one sample of
delay, and with real damping besides. K T²/m and B T/m run over the stable part of the plane. The measured k and b are
drawn as curves over the predicted ones, and their largest deviation is printed.
"""

import argparse
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import hapsim

CASES = {
    "paper_6_1_no_delay": (3.6, 1.0),
    "paper_6_2_one_sample": (0.3, 0.9),
    "paper_6_3_real_damping": (0.7, 0.9),
}
"""Of each case the largest K T²/m and B T/m."""
LITTLE = 0.05  # of the critical damping: a smaller b is not set against itself


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100, help="along each axis")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    for axes, (name, (most_k, most_b)) in zip(figure.subplots(1, 3), CASES.items(), strict=True):
        scene = hapsim.load_scene(name)
        mass, rate = scene.device.masses(1)[0], scene.rate
        unit_k, unit_b = mass * rate**2, mass * rate
        # The middles of equal cells.
        along = (np.arange(arguments.points) + 0.5) / arguments.points
        plane = {"touch.stiffness": most_k * unit_k * along, "touch.damping": most_b * unit_b * along}
        found = hapsim.sweep(scene, plane, jobs=arguments.jobs, duration=0.5, out=f"{name}.nc")
        report(name, found)
        x, y = most_b * along, most_k * along
        stable = found["stable"] > 0
        for what, unit, colour in (("k", unit_k, "C0"), ("b", unit_b, "C3")):
            levels = np.nanquantile((found[f"predicted_{what}"] / unit).where(stable), np.linspace(0.0, 1.0, 16))
            for how, shade, width in (("predicted", colour, 3.0), ("measured", "k", 0.6)):
                values = (found[f"{how}_{what}"] / unit).where(stable)
                axes.contour(x, y, values, levels, colors=shade, linewidths=width, alpha=0.6)
        axes.set(title=name, xlabel="B T/m", ylabel="K T²/m")
    figure.savefig("paper_figures.png", dpi=120)
    print("paper_figures.png: curves of equal k (blue) and b (red) as predicted, and as measured (thin, black)")


def report(name: str, found: Any) -> None:
    """Prints how many points were measured, and how far they are off the prediction."""
    both = np.isfinite(found["measured_k"]) & np.isfinite(found["predicted_k"])
    print(f"{name}: {found['error'].size} points; {int(both.sum())} feel like a spring and damper")
    for what in ("k", "b"):
        off = abs(found[f"measured_{what}"] - found[f"predicted_{what}"]).where(both)
        scale = found["predicted_k"] if what == "k" else np.maximum(found["predicted_b"], LITTLE * critical(found))
        share, sure = off / scale, off / found[f"measured_{what}_uncertainty"]
        quantiles = ", ".join(f"{float(share.quantile(q)):.0e}" for q in (0.5, 0.99, 1.0))
        within = float((sure < 3.0).sum() / both.sum())
        print(f"  {what} off by {quantiles} (median, 99 %, most); within 3 stated uncertainties in {within:.2%}")


def critical(found: Any) -> Any:
    """The damping that would be critical, N·s/m."""
    return found["predicted_b"] / found["predicted_damping_ratio"]


if __name__ == "__main__":
    main()
