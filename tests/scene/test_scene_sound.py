"""Pick-ups: what they may listen to, and the error where they cannot."""

import pytest

from hapsim.errors import SceneError
from hapsim.scene import Scene, parse_scene

TEXT = """version: 1
rate: 1000
device: {mass: 0.2}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  gut: {type: string, masses: 9, mass: 0.001, stiffness: 100}
  touch: {type: viscoelastic, between: [hand, gut.2], stiffness: 100}
sound:
  left: {from: gut.2, of: velocity, gain: 0.5, highpass: 20}
  right: {from: hand, of: force}
"""


def test_pick_ups_are_read_and_written_as_the_file_has_them() -> None:
    scene = parse_scene(TEXT, "s.yaml")
    assert [(name, one.point, one.of, one.gain, one.highpass) for name, one in scene.sound.items()] == [
        ("left", "gut.2", "velocity", 0.5, 20.0),
        ("right", "hand", "force", 1.0, 0.0),
    ]
    assert Scene.model_validate(scene.model_dump()) == scene
    assert scene.model_dump()["sound"]["left"]["from"] == "gut.2"
    assert parse_scene(TEXT[: TEXT.index("sound:")], "s.yaml").sound == {}


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("gut.2, of", "gut.9, of", "10:16: from: found 'gut.9', but 'gut' is a string; expected one of its masses, 0"),
        ("from: hand", "from: wall", "11:17: from: found 'wall', a ground, which does not move; expected a point"),
        ("from: hand", "from: touch", "11:17: from: found 'touch', which is a link; expected a point"),
        ("from: hand", "from: hnd", "11:17: from: found 'hnd', expected the name of a module of this scene; did you"),
        ("from: hand, ", "", "11:3: right: 'from' is missing, expected the name of a point, such as hand or gut.7"),
        ("of: force", "of: sound", "11:27: of: found 'sound' (text), expected velocity, position or force"),
        ("gain: 0.5", "gian: 0.5", "10:37: gian: unknown key, expected from, of, gain or highpass; did you mean"),
        ("highpass: 20", "highpass: -1", "10:58: highpass: found -1, expected a number >= 0 (Hz)"),
        ("left:", "gut:", "10:3: gut: found the name of a module too; expected one of its own"),
        ("{from: hand, of: force}", "3", "11:10: right: found 3, expected a mapping"),
        (
            "rate: 1000",
            "rate: 1000\nscheme: rk4",
            "12:27: of: found force, expected velocity or position: under scheme",
        ),
        (
            "  right:",
            "".join(f"  more{i}: {{from: hand, of: position}}\n" for i in range(15)) + "  right:",
            "9:1: sound: found 17 pick-ups, expected at most 16",
        ),
    ],
)
def test_a_wrong_pick_up_is_reported(old: str, new: str, told: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(TEXT.replace(old, new, 1), "s.yaml")
    assert str(caught.value).startswith(f"s.yaml:{told}")
    assert "\n" not in str(caught.value)
