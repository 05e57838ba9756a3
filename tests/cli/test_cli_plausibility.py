"""A wrong unit or a factor of a thousand is named, with what to write; what people build is not."""

from __future__ import annotations

import random
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

import hapsim as public
from hapsim.errors import GuardError
from hapsim.measuring.device_motion import Bounds, Drive, scene_of
from hapsim.prediction import predict, unlikely, warnings_about
from hapsim.scene import Scene, parse_scene
from hapsim.scene.shipped import shipped_scene, shipped_scenes
from tests.loaded_files import BENCHES, module_of

Hapsim = Callable[..., Any]

SCENE = """\
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0, force_limit: 10}
mock: {}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
"""
STRING = {"type": "string", "masses": 20, "mass": 0.001, "stiffness": 500.0}
TABLE = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": [[-0.01, -1.0], [0.0, 0.0]]}
RUB = {"type": "friction", "between": ["hand", "wall"], "force": 1.0, "stiffness": 500.0}


def scene_with(changes: dict[str, Any]) -> Scene:
    """The scene above with the values at these paths, such as `modules.wall.position`."""
    document = yaml.safe_load(SCENE)
    for path, value in changes.items():
        *places, key = path.split(".")
        part = document
        for place in places:
            part = part.setdefault(place, {})
        part[key] = value
    return parse_scene(yaml.safe_dump(document, sort_keys=False), "scene.yaml")


@pytest.fixture(scope="module")
def bench() -> Any:
    return module_of(BENCHES / "plausibility.py")


@pytest.mark.parametrize(
    ("path", "value", "hint"),
    [
        ("device.mass", 200, "found 200 kg, more than 10 kg: .* If you meant g, write 0.2."),
        ("device.mass", 1e-6, "found 1e-06 kg, less than 0.001 kg: .* weigh grams to 3 kg"),
        ("device.mass", {"from": 100, "to": 400}, "found 100 kg, .* write 0.1."),
        ("device.mass", {"value": 180.0, "uncertainty": 1.0}, "found 180 kg, .* write 0.18."),
        ("mock.mass", [300.0], "found 300 kg, .* write 0.3."),
        ("mock.grips", [[0.0, 200.0]], "found 200 kg, .* write 0.2."),
        ("rate", 1, "found 1 Hz, less than 50 Hz: .* If you meant kHz, write 1000."),
        ("rate", 0.0005, ".* If you meant the period in s, write 2000."),
        ("rate", 2e6, "found 2e.06 Hz, more than 100000 Hz: .* a thousandth of it, write 2000."),
        ("device.force_limit", 1e4, "found 10000 N, more than 250 N: .* If you meant mN, write 10."),
        ("device.force_limit", 0.01, "found 0.01 N, less than 0.05 N: .* write 10."),
        ("device.friction", 800, "found 800 N·s/m, more than 500 N·s/m: .* If you meant g/s, write 0.8."),
        ("device.friction", 0.0012, "found .* then stops in 167 s. If you meant N·s/mm, write 1.2."),
        ("device.friction", 60, "found 60 N·s/m, more than 50 N·s/m: a free hand of 0.2 kg then stops in 3.33 ms."),
        ("device.stiffness", 0.2, "found 0.2 N/m, .* If you meant N/mm, write 200."),
        ("device.stiffness", 2.5e4, "found 25000 N/m, more than 20000 N/m: .* by less than 0.5 mm. .* write 25."),
        ("device.delay", 0.001, "found 0.001 samples, .* period, here 1 ms. If you meant seconds, write 1."),
        ("device.delay", 500, "found 500 samples, more than 20 samples: .* If you meant µs, write 0.5."),
        ("mock.delay", 0.0015, "found .* If you meant seconds, write 1.5."),
        ("device.energy_limit", 0.0002, "found 0.0002 J, .* within 0.1 mm. .* write 0.2."),
        ("device.soft_start", 0.00005, "found 5e-05 s, less than 0.001 s: .* write 0.05."),
        ("device.travel", [-50, 50], "found -50 m, more than 1 m: .* If you meant mm, write -0.05."),
        ("device.origin", 30, "found 30 m, .* If you meant mm, write 0.03."),
        ("device.baud", 115, "found 115 bit/s, .* If you meant kbit/s, write 115000."),
        ("mock.initial.velocity", 100, "found 100 m/s, .* If you meant mm/s, write 0.1."),
        ("mock.quantum", 17.2, "found 17.2 m per count, .* If you meant µm, write 1.72e-05."),
        ("mock.noise", 0.01, "found 0.01 m rms, .* If you meant mm, write 1e-05."),
        ("mock.coulomb", 200, "found 200 N, more than 10 N: .* does not overcome it. If you meant mN, write 0.2."),
        ("mock.turnaround", 0.2, "found 0.2 s, .* If you meant ms, write 0.0002."),
        ("mock.hand.force", 2000, "found 2000 N, .* If you meant mN, write 2."),
        ("modules.wall.position", 10, "found 10 m, more than 1 m: .* If you meant mm, write 0.01."),
        ("modules.wall.position", 2e-6, "found 2e-06 m, less than 5e.6 m: .* write 0.002."),
        ("modules.touch.stiffness", 2e6, "found 2e.06 N/m, .* any damping, and needs about 8.247 kHz. .* write 2000."),
        ("modules.touch.stiffness", 2, "found 2 N/m, less than 5 N/m: 1 cm of it is 0.02 N. .* N/mm, write 2000."),
        ("modules.touch.damping", 5000, "found 5000 N·s/m, more than 400 N·s/m: .* If you meant g/s, write 5."),
        ("modules.touch.damping", 0.005, "found 0.005 N·s/m, less than 0.008 N·s/m: .* N·s/mm, write 5."),
        ("modules.gut", STRING | {"mass": 1.0}, "mass: found 1 kg, .* 20 of them weigh 20 kg. .* write 0.001."),
        ("modules.gut", STRING | {"mass": 1e-8}, "mass: found 1e-08 kg, less than 1e.7 kg: .* write 1e-05."),
        ("modules.gut", STRING | {"stiffness": 5e5}, "stiffness: found .* unstable on 0.001 kg .* write 500."),
        ("modules.gut", STRING | {"pluck": {"at": 3, "by": 3.0}}, "pluck.by: found 3 m, .* write 0.003."),
        ("modules.rub", RUB | {"force": 150.0}, "force: found 150 N, .*: the force limit is 10 N. .* 0.15."),
        ("modules.click", TABLE | {"force_over_distance": [[-10, -1], [0, 0]]}, "force_over_distance: found -10 m.*"),
        ("modules.click", TABLE | {"force_over_distance": [[0, 0], [1e-2, 900]]}, "force_over_distance: found 900 N.*"),
    ],
)  # fmt: skip
def test_each_mistake_is_named_by_its_key_with_what_to_write(path: str, value: Any, hint: str) -> None:
    (found,) = unlikely(scene_with({path: value}))
    assert re.fullmatch(rf"{re.escape(path)}[:.] ?{hint}.*", found), found


@pytest.mark.parametrize(("mass", "friction", "named"), [(0.2, 50.1, True), (5.5, 194.0, False), (5.5, 551.0, True)])
def test_the_most_friction_that_is_likely_grows_with_the_declared_mass(
    mass: float, friction: float, named: bool
) -> None:
    found = unlikely(scene_with({"device.mass": mass, "device.friction": friction}))
    assert [one.partition(":")[0] for one in found] == ["device.friction"] * named


def test_what_is_found_and_why_it_is_unlikely_are_in_the_same_units() -> None:
    """A number that is unlikely is one without a unit, in SI units."""
    text = SCENE.replace("mass: 0.2", "mass: 200 g").replace("friction: 1.0", "friction: 60")
    (found,) = unlikely(parse_scene(text))
    assert "found 60 N·s/m, more than 50 N·s/m: a free hand of 0.2 kg then stops in 3.33 ms." in found


def test_the_velocity_of_a_filtered_damper_has_its_own_bounds() -> None:
    (found,) = unlikely(scene_with({"modules.touch.damper": "filtered", "modules.touch.cutoff": 0.2}))
    assert found.startswith("modules.touch.cutoff: found 0.2 Hz, less than 1 Hz: ")
    assert found.endswith("If you meant kHz, write 200.")


@pytest.mark.parametrize(
    ("path", "value", "hint"),
    [
        ("device.mass", 50, "found 50 kg·m², more than 0.5 kg·m²: .* If you meant g·cm², write 50 g·cm²."),
        ("device.force_limit", 300, "found 300 N·m, .* If you meant mN·m, write 300 mN·m."),
        ("modules.detent.pitch", 15, "found 15 rad, more than 7 rad: .* If you meant deg, write 15 deg."),
        ("mock.initial.velocity", 3000, "found 3000 rad/s, .* If you meant deg/s, write 3000 deg/s."),
        ("modules.frame.position", 90, "found 90 rad, more than 20 rad: .* If you meant deg, write 90 deg."),
        ("device.travel", [-120, 2], "found -120 rad, more than 20 rad: .* If you meant deg, write -120 deg."),
    ],
)
def test_a_knob_is_judged_in_radians(path: str, value: Any, hint: str) -> None:
    knob = yaml.safe_load(shipped_scene("knob_24"))
    place, _, key = path.rpartition(".")
    part = knob
    for name in place.split("."):
        part = part[name]
    part[key] = value
    (found,) = unlikely(parse_scene(yaml.safe_dump(knob), "knob.yaml"))
    assert re.fullmatch(f"{re.escape(path)}: {hint}", found), found


def test_friction_far_above_critical_is_named() -> None:
    (found,) = unlikely(scene_with({"device.friction": 40, "modules.touch.stiffness": 20}))
    assert "found 40 N·s/m, more than 20 N·s/m: critical damping is 4 N·s/m, so the hand creeps" in found


def test_the_same_mistake_in_several_modules_is_one_sentence() -> None:
    stop = {"type": "buffer", "between": ["hand", "wall"], "stiffness": 3000.0, "damping": 4.0, "distance": -5.0}
    (found,) = unlikely(scene_with({"modules.stop": stop, "modules.other": stop, "modules.third": stop}))
    assert found.startswith("modules.stop.distance: found -5 m")
    assert found.endswith("If you meant mm, write -0.005. The same holds for 2 other modules.")


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"modules.wall.position": 0.8}, "with 1600 N; .*: modules.wall.position is 0.8 m. .*, write 0.0008."),
        ({"mock.initial.position": -0.4}, "with 800 N; .*: mock.initial.position is -0.4 m. .*, write -0.0004."),
        ({"device.travel": [0.3, 0.4]}, None),  # what is armed is the mock, at 0
        ({"device.travel": [0.3, 0.4], "device.port": "/dev/ttyACM0"}, "with 600 N; .*: device.travel is 0.3 m. .*"),
        ({"mock.initial.position": 0.4, "device.origin": 0.4}, None),
        ({"mock.initial.position": 0.4, "device.origin": "here"}, None),
        ({"mock.initial.position": 0.02, "modules.touch.stiffness": 2e4}, "with 400 N; .*: check the stiffness .*"),
        ({"mock.initial.position": 0.014, "modules.touch.stiffness": 2e4}, None),
    ],
)  # fmt: skip
def test_a_force_at_arming_far_above_the_limit_is_named(changes: dict[str, Any], found: str | None) -> None:
    hints = unlikely(scene_with(changes))
    assert len(hints) == (found is not None), hints
    if found is not None:
        assert re.fullmatch(rf"at arming the scene pushes hand {found}", hints[0]), hints[0]


def test_the_force_at_arming_is_that_of_all_links_of_a_hand() -> None:
    """Two springs that pull to both sides hold each other."""
    other = {"type": "spring", "between": ["back", "hand"], "stiffness": 2000.0}
    pulled = {"modules.wall.position": 0.08, "modules.back": {"type": "ground", "position": -0.08}}
    assert unlikely(scene_with(pulled))
    assert not unlikely(scene_with(pulled | {"modules.hold": other}))


def test_no_scene_that_ships_has_a_hint() -> None:
    for name in shipped_scenes():
        scene = parse_scene(shipped_scene(name), name)
        for one in map(scene.with_others_held, scene.ports) if scene.ports else [scene]:
            assert not unlikely(one), name


@pytest.mark.thorough
def test_random_devices_as_people_build_them_have_no_hint(bench: Any) -> None:
    chance = random.Random(11)
    scenes = [bench.sensible_scene(chance) for _ in range(30)]
    assert [unlikely(parse_scene(yaml.safe_dump(one), "by chance")) for one in scenes] == [[]] * 30


@pytest.mark.thorough
def test_most_wrong_units_are_named_and_with_the_value_that_was_meant(bench: Any) -> None:
    """Unnoticed slips are harmless or stay within the usual range: tools/bench/README.md."""
    counted: Counter[str] = Counter()
    for spoiled in bench.spoiled_scenes(50, 3):
        verdict = bench.judge(spoiled)
        counted[verdict.kind] += 1
        counted["right"] += verdict.is_right
    assert counted["named"] >= 35
    assert counted["right"] >= 0.93 * counted["named"]
    assert counted["other"] <= 3


def test_a_rate_or_baud_that_is_named_is_not_named_again_by_the_wire() -> None:
    port = {"device.port": "/dev/ttyACM0"}
    slow, wrong = scene_with(port | {"device.baud": 9600}), scene_with(port | {"device.baud": 115})
    about_slow, about_wrong = (warnings_about(one, predict(one, with_margins=False)) for one in (slow, wrong))
    assert [one[:12] for one in about_slow] == ["an exchange "]
    assert [one[:12] for one in about_wrong] == ["device.baud:"]


def test_check_run_and_measure_print_the_hint(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("mass: 0.2", "mass: 200, clock: lockstep"), encoding="utf-8")
    hint = unlikely(public.load_scene(path))[0]
    assert hapsim("check", path).words.endswith(f"Warning: {hint} Next: hapsim measure {path}")
    assert hapsim("check", path, "--json").document["warnings"] == [hint]
    for words in (["run", path, "--duration", 0.05], ["measure", path]):
        answer = hapsim(*words, "--json")
        assert f"Warning: {hint}\n" in answer.err
        assert answer.document["warnings"] == [hint]


def test_a_scene_that_is_not_armed_reports_what_is_probably_wrong(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace("2000", "2.0e+6"), encoding="utf-8")
    answer = hapsim("run", path)
    (hint,) = unlikely(public.load_scene(path))
    assert answer.status == 2
    assert f"stable below 1). {hint} `hapsim check` reports more." in answer.sentence
    assert "less stiffness" not in answer.sentence
    path.write_text(SCENE.replace("mass: 0.2", "mass: 0.2, travel: [-5.0e-5, 5.0e-5]"), encoding="utf-8")
    assert "If you meant a thousand times as much, write -0.05" in hapsim("check", path).refusal


def test_more_detents_than_can_be_distinguished_are_an_error_in_words(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    detent = "  notch: {type: detent, between: [hand, wall], pitch: 0.005, depth: 0.1}\n"
    path.write_text(SCENE.replace("mass: 0.2", "mass: 0.2, travel: [-50, 50]") + detent, encoding="utf-8")
    refusal = hapsim("check", path).refusal
    assert "modules.notch: found more than 4000 edges between -50 and 50 m; expected a larger pitch" in refusal


def test_a_run_that_a_guard_ends_repeats_the_hint_in_place_of_its_advice(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    text = SCENE.replace("2000", "2.0e+6").replace("mass: 0.2", "mass: 0.2, clock: lockstep")
    path.write_text(text.replace("mock: {}", "mock: {initial: {velocity: 0.1}}"), encoding="utf-8")
    answer = hapsim("run", path, "--unstable", "--duration", 20, "--json")
    (hint,) = unlikely(public.load_scene(path))
    assert answer.status == 4
    assert f"the last force was not sent. A likely mistake: {hint.removesuffix('.')}; the force is zero" in answer.err
    assert "less stiffness" not in answer.err


def test_without_an_unlikely_value_a_guard_advises_as_before() -> None:
    scene = scene_with({"device.clock": "lockstep", "modules.touch.stiffness": 20000, "mock.initial.velocity": 0.1})
    assert not unlikely(scene)
    with pytest.raises(GuardError, match="reports what would make the scene stable; less stiffness, "):
        public.run(scene, duration=20, judges_energy=True, unstable=True)


def test_values_that_hapsim_chose_for_a_measurement_are_no_mistakes_of_the_user() -> None:
    scene = scene_with({"device.force_limit": 0.003})
    assert unlikely(scene)
    assert not unlikely(scene_of(scene, Bounds(0.003, 0.005), 0, Drive(2.5, 0.1, 0.003, 100), 0.0))


@pytest.mark.parametrize(
    ("between", "stiffness", "ratio", "found"),
    [("[fader, knob]", 200, 0.01, "20000 N/m"), ("[knob, fader]", 0.02, 100, "2 N·m/rad")],
)
def test_link_with_a_ratio_is_judged_at_each_end(between: str, stiffness: float, ratio: float, found: str) -> None:
    def hints(times: float, devices: bool) -> list[str]:
        own = {"left": "mass: 0.1, friction: 1.0", "right": "motion: rotary, mass: 2.0e-6, friction: 1.0e-5"}
        parts = ", ".join(f"{name}: {{{keys}, force_limit: 5}}" for name, keys in own.items())
        one = "{motion: [linear, rotary], mass: [0.1, 2.0e-6], friction: [1.0, 1.0e-5], force_limit: 5}"
        return unlikely(
            parse_scene(
                f"version: 1\nrate: 1000\n{f'devices: {{{parts}}}' if devices else f'device: {one}'}\nmodules:\n"
                f"  fader: {{type: device, channel: 0{', of: left' if devices else ''}}}\n"
                f"  knob: {{type: device, channel: {'0, of: right' if devices else 1}}}\n"
                f"  tie: {{type: viscoelastic, between: {between}, stiffness: {times * stiffness}, "
                f"damping: {stiffness / 200}, ratio: {ratio}}}\n"
            )
        )

    for devices in (False, True):
        assert hints(1.0, devices) == []
        (hint,) = hints(100.0, devices)
        assert f"modules.tie.stiffness: found {found}, more than " in hint
        assert " on 2e-06 kg·m² with any damping" in hint


def test_value_of_one_of_several_devices_has_its_path_in_the_file(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "heavy.yaml"
    path.write_text(shipped_scene("two_devices").replace("mass: 0.2  ", "mass: 200  ", 1))
    assert "devices.left.mass: found 200 kg, more than 10 kg" in unlikely(public.load_scene(path))[0]
    assert "Warning: devices.left.mass: found 200 kg" in hapsim("check", path).out
