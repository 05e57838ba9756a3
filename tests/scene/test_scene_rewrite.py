"""Other values for a scene's device: nothing else of the file changes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hapsim.errors import UsageError
from hapsim.scene import Known, load_scene, parse_scene
from hapsim.scene.rewrite import device_rewritten, rewrite_device
from hapsim.scene.shipped import shipped_scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
VALUES = {"mass": "0.21345", "friction": "0.98", "delay": "1.0213"}
FLOW = """version: 1
rate: 1000
device: {clock: lockstep, mass: &m 0.2, friction: 1.0}   # all of it
modules:
  hand: {type: device, channel: 0}
  ball: {type: mass, mass: *m}
"""


@pytest.mark.parametrize(
    "path", sorted({*CONFIGS.glob("*.yaml")} - {CONFIGS / "admittance.yaml"}), ids=lambda path: path.stem
)
def test_of_every_shipped_scene_only_the_values_change(path: Path) -> None:
    before = path.read_text(encoding="utf-8")
    old = parse_scene(before)
    name = old.ports[-1] if old.ports else None
    after = device_rewritten(before, VALUES, channel=0, device=name)
    scene = parse_scene(after)
    if name is not None:
        assert scene.devices[old.ports[0]] == old.devices[old.ports[0]]
        old, scene = (one.with_others_held(name) for one in (old, scene))
    device = scene.device
    assert (device.masses(scene.channels)[0], device.frictions(scene.channels)[0]) == (0.21345, 0.98)
    assert device.delay == 1.0213
    assert device.masses(scene.channels)[1:] == old.device.masses(old.channels)[1:]
    assert device.frictions(scene.channels)[1:] == old.device.frictions(old.channels)[1:]
    assert (scene.modules, scene.mock) == (old.modules, old.mock)
    changed = {new.split(":")[0].strip() for new in set(after.splitlines()) - set(before.splitlines())}
    assert changed <= VALUES.keys()
    assert [line.partition("#")[2] for line in after.splitlines() if "#" in line] == [
        line.partition("#")[2] for line in before.splitlines() if "#" in line
    ]


def test_a_comment_stays_in_its_column_and_a_new_key_stands_where_it_belongs() -> None:
    after = device_rewritten(shipped_scene("first_touch.yaml"), VALUES | {"stiffness": "12.5"}, channel=0)
    assert (
        "  mass: 0.21345                # kg, moving part and hand\n"
        "  friction: 0.98               # N·s/m\n"
        "  stiffness: 12.5\n"
        "  delay: 1.0213                # sample periods"
    ) in after


def test_of_several_channels_one_is_written() -> None:
    after = device_rewritten(shipped_scene("four_keys.yaml"), VALUES | {"stiffness": "12.5"}, channel=2)
    assert "  mass: [0.08, 0.08, 0.21345, 0.1]     # kg, per channel\n" in after
    assert "  friction: [0.6, 0.6, 0.98, 0.6]  # N·s/m\n" in after
    assert "  stiffness: [0, 0, 12.5, 0]\n" in after


MEASURED = Known(value=0.2, uncertainty=0.001)


def test_a_measured_mass_is_written_with_its_uncertainty_and_again() -> None:
    text = shipped_scene("first_touch.yaml")
    once = device_rewritten(text, {"mass": MEASURED}, channel=0)
    assert "  mass: {value: 0.2, uncertainty: 0.001}  # kg, moving part and hand\n" in once
    device = parse_scene(once).device
    assert (device.masses(1), device.mass_spans(1), device.mass_uncertainties(1)) == ((0.2,), ((0.2, 0.2),), (0.001,))
    assert parse_scene(text).device.mass_uncertainties(1) == (None,)
    assert device_rewritten(once, {"mass": "0.2"}, channel=0).split() == text.split()


def test_a_measured_mass_among_several_leaves_the_others_as_they_are() -> None:
    keys = device_rewritten(shipped_scene("four_keys.yaml"), {"mass": MEASURED}, channel=2)
    assert "  mass: [0.08, 0.08, {value: 0.2, uncertainty: 0.001}, 0.1]" in keys
    assert parse_scene(keys).device.mass_uncertainties(4) == (None, None, 0.001, None)
    for mapping in ("{from: 0.1, to: 0.4}", "\n    from: 0.1\n    to: 0.4"):
        two = shipped_scene("two_hands.yaml").replace("mass: [0.15, 0.2] ", f"mass: {mapping} ")
        after = device_rewritten(two, {"mass": MEASURED, "stiffness": "3"}, channel=1)
        assert "[{from: 0.1, to: 0.4}, {value: 0.2, uncertainty: 0.001}]" in after
        assert "\n  stiffness: [0, 3]\n" in after


def test_a_device_in_braces_stays_in_them() -> None:
    after = device_rewritten(FLOW, {"friction": "2.5", "delay": "1.5"}, channel=0)
    assert "device: {clock: lockstep, mass: &m 0.2, friction: 2.5, delay: 1.5}   # all of it\n" in after


def test_a_value_that_stands_for_others_too_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(FLOW, encoding="utf-8")
    with pytest.raises(UsageError, match=r"scene\.yaml: nothing was written: .* anchor .*: device\.mass: 0\.3"):
        rewrite_device(str(path), {"mass": "0.3"}, channel=0)
    assert path.read_text(encoding="utf-8") == FLOW


def test_a_file_keeps_its_line_endings_and_permissions_and_a_link_to_it(tmp_path: Path) -> None:
    path, link = tmp_path / "scene.yaml", tmp_path / "link.yaml"
    path.write_bytes(shipped_scene("first_touch.yaml").replace("\n", "\r\n").encode())
    path.chmod(0o640)
    link.symlink_to(path)
    rewrite_device(str(link), VALUES | {"stiffness": "3"}, channel=0)
    assert link.is_symlink()
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.read_bytes().count(b"\n") == path.read_bytes().count(b"\r\n")
    assert load_scene(link).device.stiffness == 3.0
    assert [entry.name for entry in tmp_path.iterdir() if entry.name.startswith(".")] == []


def test_a_file_that_cannot_be_written_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(FLOW, encoding="utf-8")
    monkeypatch.setattr(os, "access", lambda *_: False)  # for root may write anything
    with pytest.raises(UsageError, match="cannot be written; check its permissions"):
        rewrite_device(str(path), VALUES, channel=0)


BELT = {"stiffness": "20000", "damping": "1.5", "motor_mass": "0.05", "sensor": "motor", "friction_at": "handle"}
TRANSMISSION = {f"transmission.{name}": value for name, value in BELT.items()} | {"motor_lag": "0.0001"}


@pytest.mark.parametrize(
    ("device", "hands", "lines"),
    [
        (
            "\n  mass: 200 g   # both\n",
            1,
            [
                "mass: 200 g   # both",
                "transmission: {stiffness: 20000 N/m, damping: 1.5 N·s/m, motor_mass: 50 g, sensor:",
            ],
        ),
        (
            " {mass: 0.2, transmission: {stiffness: 10 N/mm, motor_mass: 40 g}}\n",
            1,
            ["stiffness: 20 N/mm", "50 g", "motor_lag: 0.0001 s"],
        ),
        (
            "\n  mass: 0.2\n  transmission:   # belt\n    motor_mass: 40 g   # motor\n    stiffness: 9  # soft\n",
            2,
            ["transmission:   # belt", "[50 g, 40 g]  # motor", "stiffness: [20000, 9]  # soft", "[0.0001 s, 0 s]"],
        ),
        ("\n  mass: 0.2\n", 2, ["motor_mass: [0.05, 0]", "sensor: [motor, motor]"]),
    ],
    ids=["new", "in braces", "in lines, two channels", "new, two channels"],
)
def test_a_transmission_is_written_and_no_other_value_changes(device: str, hands: int, lines: list[str]) -> None:
    modules = "".join(f"  hand{i}: {{type: device, channel: {i}}}\n" for i in range(hands))
    after = device_rewritten(f"version: 1\nrate: 1000\ndevice:{device}modules:\n{modules}", TRANSMISSION, channel=0)
    assert all(line in after for line in lines), after
    first, *others = parse_scene(after).device.drives(hands)
    assert first[:5] == (20000.0, 1.5, 0.05, "motor", "handle")
    assert first.lag == 1e-4
    assert all(other.lag == 0.0 and other.motor_mass in (0.0, 0.04) for other in others)
