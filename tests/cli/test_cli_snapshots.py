"""The figures that `check` predicts of the shipped scenes and of random ones, and the keys of JSON documents, beside
those that were kept. To renew a kept file where a change is meant, delete it and run this test: it is written anew and
the test fails once."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from hapsim import predict
from hapsim.prediction import Prediction
from hapsim.scene import WITH_CUTOFF, DamperScheme, SchemeName, load_scene, parse_scene
from hapsim.scene.choices import WITH_SENSOR

HERE = Path(__file__).parent
CONFIGS = HERE.parents[1] / "configs"
LARGE = {"bell", "bowed_string", "plucked_string", "struck_membrane"}  # their margins take seconds


def kept(name: str, now: list[str]) -> list[str]:
    """The lines of the kept file."""
    file = HERE / name
    if not file.exists():
        file.write_text("".join(f"{line}\n" for line in now), encoding="utf-8")
        pytest.fail(f"{name} was not there, and is written: look at what changed")
    return file.read_text("utf-8").splitlines()


def figures_of(prediction: Prediction) -> list[float]:
    """k and b where a hand has them, the spectral radius, 1 where stable, and what each margin found is."""
    margins = [factor for one in prediction.margins for factor in (one.stiffness_factor, one.damping_factor)]
    felt = [prediction.k, prediction.b] if prediction.felt else []
    return [*felt, prediction.spectral_radius, float(prediction.stable), *margins]


def random_documents(number: int) -> Iterator[dict[str, Any]]:
    """A hand on a spring, or on a mass on a spring, of any scheme, sampling and delay, and of any damper that needs no
    sensor."""
    chance = random.Random(50)
    for _ in range(number):
        damper = chance.choice([name for name in get_args(DamperScheme) if name not in WITH_SENSOR])
        link = {"type": "viscoelastic", "damper": damper} | ({"cutoff": 200.0} if damper in WITH_CUTOFF else {})
        modules: dict[str, Any] = {"wall": {"type": "ground"}, "hand": {"type": "device", "channel": 0}}
        ends = ["hand", "wall"]
        if chance.random() < 0.5:
            modules["ball"] = {"type": "mass", "mass": chance.uniform(0.05, 0.5)}
            ends = ["hand", "ball", "wall"]
        for one, other in itertools.pairwise(ends):
            of_link = {"stiffness": chance.uniform(50.0, 3000.0), "damping": chance.uniform(0.1, 8.0)}
            modules[f"{one}_{other}"] = link | of_link | {"between": [one, other]}
        device = {"mass": chance.uniform(0.1, 0.5), "friction": chance.uniform(0.1, 2.0), "clock": "lockstep"}
        device |= {"delay": chance.choice((0.0, 0.4, 1.0, 2.0)), "sampling": chance.choice(("ideal", "average"))}
        scheme = chance.choice(get_args(SchemeName))
        yield {"version": 1, "rate": 1000, "scheme": scheme, "device": device, "modules": modules}


def test_the_predicted_figures_are_those_that_were_kept() -> None:
    """Predicted figures match to 1e-9: of small shipped scenes with margins, of the large and random ones without."""
    now = {
        path.stem: figures_of(predict(load_scene(path), with_margins=path.stem not in LARGE))
        for path in sorted(CONFIGS.glob("*.yaml"))
        if path.stem != "two_devices"
    }
    for n, document in enumerate(random_documents(40)):
        scene = parse_scene(yaml.safe_dump(document, sort_keys=False), f"random {n}")
        now[f"random_{n}"] = figures_of(predict(scene, with_margins=False))
    lines = [" ".join((name, *(f"{value:.12g}" for value in values))) for name, values in now.items()]
    before = {name: [*map(float, values)] for name, *values in map(str.split, kept("check_figures.txt", lines))}
    assert now.keys() == before.keys()
    for name, values in now.items():
        assert values == pytest.approx(before[name], rel=1e-9, abs=1e-12, nan_ok=True), name


def keys_of(value: Any, path: str = "") -> Iterator[str]:
    """Each key of a document with those above it; of a list what its members have."""
    if isinstance(value, dict):
        for key, below in value.items():
            yield from keys_of(below, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for below in value:
            yield from keys_of(below, f"{path}[]")
    else:
        yield path


def test_the_keys_of_json_documents_are_those_that_were_kept(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    """JSON documents keep their keys, for scenes with one hand, several, regions, masses and a correction."""
    files = {}
    for name in ("first_touch", "two_hands", "knob_24", "plucked_string"):
        document = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text("utf-8"))
        document["device"]["clock"] = "lockstep"
        files[name] = tmp_path / f"{name}.yaml"
        files[name].write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    touch, corrected = files["first_touch"], files["first_touch"].with_name("corrected.yaml")
    corrected.write_text(touch.read_text("utf-8").replace("  mass:", "  correction: poles\n  mass:"), encoding="utf-8")
    commands = [["check", file] for file in (*files.values(), corrected)]
    commands += [["measure", touch], ["run", touch, "--duration", "0.1"], ["identify", touch]]
    commands += [["sweep", touch, "rate=1000,2000", "--check"], ["new", "--list"], ["faults", "--list"]]
    lines = []
    for command, *words in commands:
        found = sorted({*keys_of(hapsim(command, *words, "--json").document)})
        lines += [f"{command} {Path(words[0]).stem if words else ''}: {key}" for key in found]
    assert lines == kept("json_keys.txt", lines)
