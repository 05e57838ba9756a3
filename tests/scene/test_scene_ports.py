"""Scenes of several devices: the scene at each port, values by path, and what does not fit together."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapsim.cordis.program import compile_scene
from hapsim.errors import SceneError, UsageError
from hapsim.scene import Scene, parse_scene
from hapsim.scene.at_port import AwayPoint
from hapsim.scene.scene import Ground
from hapsim.scene.varied import Varied
from tests.port_scenes import MORE, TWO, two_devices


def at_ports(text: str) -> dict[str, Scene]:
    scene = parse_scene(text)
    return {name: scene.at_port(name) for name in scene.ports}


class TestAtAPort:
    def test_are_its_points_its_links_and_what_they_touch(self) -> None:
        left, right = at_ports(MORE).values()
        assert [*left.modules] == ["floor", "thumb", "finger", "ball", "own", "touch", "pluck", "gut-2"]
        assert [*right.modules] == ["floor", "finger", "hand", "ball", "gut", "touch", "pluck", "hold", "tie"]
        assert left.modules["pluck"].between == ("gut-2", "finger")  # type: ignore[attr-defined]
        assert right.modules["pluck"].between == ("gut.2", "finger")  # type: ignore[attr-defined]

    def test_points_of_others_are_device_points_on_the_last_channels(self) -> None:
        left, right = at_ports(MORE).values()
        assert left.away == (AwayPoint("ball", "right", "ball", 14), AwayPoint("gut-2", "right", "gut.2", 15))
        assert right.away == (AwayPoint("finger", "left", "finger", 15, friction=1.0),)
        assert (left.channels, left.all_channels, left.channel_groups) == (2, 16, ((0,), (1,)))
        assert [point.channel for point in right.device_points.values()] == [15, 0]

    def test_each_has_its_device_and_mock_and_the_leader_the_sound(self) -> None:
        text = MORE + "mocks:\n  left: {coulomb: 0.1}\n"
        left, right = at_ports(text).values()
        assert left.device == parse_scene(text).devices["left"]
        assert (left.mock_device.coulomb, right.mock_device.coulomb) == (0.1, 0.0)
        assert (list(left.sound), list(right.sound)) == ([], ["ear"])
        assert (left.ports, left.device_name, right.device_name) == ((), "left", "right")

    def test_is_read_back_from_its_text_and_compiled(self) -> None:
        for one in at_ports(MORE).values():
            again = parse_scene(one.to_yaml())
            assert again.document == one.document
            assert again.away == one.away
            assert len(compile_scene(again).numbers) >= len(one.device_points)

    def test_a_proxy_moves_with_its_hand(self) -> None:
        text = TWO.replace("modules:", "modules:\n  floor: {type: ground}")
        text += "  ghost: {type: proxy, hand: b, mass: 0.01, stiffness: 1000, damping: 1}\n"
        text += "  wall: {type: buffer, between: [ghost, floor], stiffness: 1000, damping: 1}\n"
        left, right = at_ports(text).values()
        assert "ghost" not in left.modules
        assert {"ghost", "wall"} <= right.modules.keys()

    def test_a_name_is_refused_that_no_device_has(self) -> None:
        with pytest.raises(UsageError, match=r"found the device 'middle', expected one of this scene \(left, right\)"):
            two_devices().at_port("middle")

    def test_with_others_held_their_points_are_grounds(self) -> None:
        alone = parse_scene(MORE).with_others_held("left")
        assert (alone.at, alone.away, alone.channels, alone.device_name) == (None, (), 2, "left")
        assert alone.modules["gut-2"] == alone.modules["ball"] == Ground(position=0.0)
        assert parse_scene(alone.to_yaml()).document == alone.document


class TestTheWhole:
    def test_has_no_device_without_a_name(self) -> None:
        with pytest.raises(UsageError, match="several devices, left and right: name one, such as --device left"):
            _ = two_devices().device

    def test_is_read_back_from_its_text(self) -> None:
        scene = parse_scene(MORE)
        assert parse_scene(scene.to_yaml()).document == scene.document
        assert (scene.leader, two_devices().leader) == ("right", "left")

    def test_values_are_named_with_the_device(self) -> None:
        scene = two_devices().changed({"left.delay": 2, "devices.right.mass": "300 g", "mocks.left.coulomb": 0.1})
        assert (scene.devices["left"].delay, scene.devices["right"].delay) == (2.0, 1.0)
        assert (scene.devices["right"].mass, scene.mocks["left"].coulomb) == (0.3, 0.1)
        assert {"left.mass", "mocks.right.hand.force"} <= {*Varied(scene).known}
        with pytest.raises(UsageError, match=r"found 'midle.delay'.*left.delay"):
            scene.changed({"midle.delay": 1})

    def test_units_are_those_of_each_device(self) -> None:
        text = TWO.replace("right: {", "right: {motion: rotary, stiffness: 1 mN·m/deg, ").split("  spring")[0]
        scene = parse_scene(text + "  wall: {type: ground}\n  t: {type: spring, between: [b, wall], stiffness: 2}\n")
        assert scene.devices["right"].stiffness == pytest.approx(0.0572958)
        assert (scene.units_at("t").is_rotary, scene.units_at("a").is_rotary) == (True, False)
        assert [scene.at_port(name).units.is_rotary for name in scene.ports] == [False, True]
        with pytest.raises(SceneError, match=r"5:38: stiffness: found 1 mN/m, .*N·m/rad"):
            parse_scene(text.replace("N·m/deg", "N/m"))


PROXY = """\
  ghost: {type: proxy, hand: a, mass: 0.01, stiffness: 1000, damping: 1}
  wall: {type: buffer, between: [ghost, b], stiffness: 1000, damping: 1}
"""

#: What is put in place of what in the scene of two devices, and a part of its message.
WRONG = [
    ("devices:", "device: {mass: 1, friction: 1}\ndevices:", "3:1: device: found device beside devices"),
    ("modules:", "mock: {noise: 0}\nmodules:", "mock: found mock beside devices, expected mocks alone"),
    ("modules:", "leader: midle\nmodules:", "leader: found 'midle', expected the name of a device: left or right"),
    ("modules:", "mocks: {rihgt: {noise: 0}}\nmodules:", "rihgt: found 'rihgt', .*; did you mean 'right'?"),
    ("of: right", "of: rihgt", "of: found 'rihgt', expected the name of a device: .*; did you mean 'right'?"),
    ("of: right, ", "", "b: 'of' is missing, expected the name of a device: left or right"),
    ("of: right", "of: left", "right: no module holds it"),
    (
        "b: {type: device, of: right, channel: 0}",
        "b: {type: device, of: left, channel: 0}",
        "0, which 'a' already uses",
    ),
    ("  right: {clock: lockstep, mass: 0.2, friction: 1}\n", "", "devices: found left alone, expected two devices"),
    ("right", "a", "a: found the name of a module or a pick-up too"),
    ("right: {clock: lockstep", "right: {clock: device", "clock: found device beside lockstep; expected one kind"),
    ("right: {", "right: {correction: poles, ", "correction: found poles, expected none: 'spring' ties it to left"),
    ("right: {", "right: {law: board, ", "law: found board, expected host: 'spring' ties it to left"),
    (
        "right: {clock: lockstep, mass: 0.2",
        "right: {clock: lockstep, mass: [1, 2]",
        "mass: found 2 numbers, expected 1",
    ),
    ("right: {", "right: {travel_margin: 1 mm, ", "add devices.right.travel: "),
    ("right: {", "right: {motion: rotary, ", "linear and rotary mixed on one link: found 'a', which is linear and 'b'"),
    ("damping: 5", "damping: 5, damper: sensed", "damper: found sensed between two devices"),
    ("  spring", f"{PROXY}  spring", "between: found 'ghost', a proxy, on a link to another device"),
    ("modules:", "inputs: {touch: {bit: 0}}\nmodules:", "inputs: found digital words in a scene with several devices"),
    ("rate: 1000", "rate: 1000\nspace: 2", "space: found 2 with several devices, expected 1"),
    ("modules:", "sound: {ear: {from: b, of: velocity}}\nmodules:", "from: found 'b', a point of right; expected one"),
    ("devices:", "device:", "right: unknown key"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG, ids=[message[:40] for *_, message in WRONG])
def test_what_does_not_fit_together_is_refused(old: str, new: str, message: str) -> None:
    assert old in TWO
    with pytest.raises(SceneError, match=message):
        parse_scene(TWO.replace(old, new))


def test_two_devices_at_one_port_are_found_by_any_of_its_names(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(port := tmp_path / "ttyACM0")
    text = TWO.replace("left: {", f"left: {{port: {port}, ").replace("right: {", f"right: {{port: {tmp_path}/by-id, ")
    with pytest.raises(SceneError, match=r"5:17: port: found .*, the port of left too; expected another"):
        parse_scene(text)
    with pytest.raises(SceneError, match="the port of left too"):
        two_devices().changed({"left.port": "tcp://Arm:7472", "right.port": "tcp://arm:7472"})
    with pytest.raises(SceneError, match="the port of left too"):
        two_devices().changed({"left.port": "tcp://127.0.0.1:7472", "right.port": "tcp://localhost:7472"})
    assert two_devices().changed({"left.port": "tcp://127.0.0.1:7472", "right.port": "tcp://localhost:7473"}).ports


def test_points_of_others_leave_a_device_fewer_channels() -> None:
    points = "".join(f"  p{i}: {{type: device, of: left, channel: {i}}}\n" for i in range(1, 16))
    with pytest.raises(SceneError, match="left: found 16 channels, and 1 points of other devices on its links"):
        parse_scene(TWO + points)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("channel: 0}", "channel: 0, of: left}", "of: found 'left' in a scene of one device"),
        ("modules:", "leader: left\nmodules:", "leader: found leader in a scene of one device"),
        ("modules:", "mock: {phase: 0.5}\nmodules:", "phase: found a phase in a scene of one device"),
        ("device: {mass: 1, friction: 1}\n", "", "1:1: 'device' is missing, expected a mapping"),
    ],
)
def test_a_scene_of_one_device_has_none_of_it(old: str, new: str, message: str) -> None:
    one = "version: 1\nrate: 1000\ndevice: {mass: 1, friction: 1}\nmodules:\n  hand: {type: device, channel: 0}\n"
    with pytest.raises(SceneError, match=message):
        parse_scene(one.replace(old, new))
