"""The travel of a hand in the plane: a disc or a polygon."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml

from hapsim.errors import SceneError
from hapsim.prediction.plausibility import begun_inside, unlikely
from hapsim.scene import Device, Scene, parse_scene


def document(travel: object, channels: object = (0, 1), **others: Any) -> dict[str, Any]:
    device = {"mass": 0.2, **({} if travel is None else {"travel": travel}), **others.pop("device", {})}
    modules = {"hand": {"type": "device", "channels": list(channels)}} | others.pop("modules", {})  # type: ignore[call-overload]
    return {"version": 1, "rate": 1000, "space": 2, "device": device, "modules": modules, **others}


def planar(travel: object, channels: object = (0, 1), **others: Any) -> Scene:
    return parse_scene(yaml.safe_dump(document(travel, channels, **others)), "scene")


@pytest.mark.parametrize(
    ("travel", "box"),
    [
        ({"disc": 0.08}, ((-0.08, 0.08), (-0.08, 0.08))),
        ({"disc": "80 mm", "center": ["1 cm", -0.02]}, ((-0.07, 0.09), (-0.1, 0.06))),
        ({"polygon": [[0, 0], [0.1, 0], ["2 cm", 0.05]]}, ((0.0, 0.1), (0.0, 0.05))),
        ([-0.1, 0.2], ((-0.1, 0.2), (-0.1, 0.2))),
        ([[-0.1, 0.2], [0, 0.3]], ((-0.1, 0.2), (0.0, 0.3))),
    ],
)
def test_the_limits_of_a_channel_are_those_of_the_box_around_the_travel(travel: object, box: Any) -> None:
    scene = planar(travel)
    for limits, expected in zip(scene.device.travels(2), box, strict=True):
        assert limits == pytest.approx(expected)
    again = parse_scene(json.dumps(scene.model_dump(mode="json", exclude_none=True)), "again")
    assert again.device == scene.device
    assert Device(mass=0.2, travel=scene.device.travel).travel == scene.device.travel
    assert unlikely(scene) == []


@pytest.mark.parametrize(
    ("travel", "found"),
    [
        ({"disc": 0}, "disc: found 0, expected a number > 0 (m)"),
        ({"disc": "1 kg"}, "disc: found 1 kg, expected a length (m)"),
        ({"disc": 0.1, "center": [1]}, "center: found a list of 1, expected two numbers [x, y] (m)"),
        ({"disc": 0.1, "radius": 1}, "travel: found a mapping, expected [the least, the most] (m), or a list of such"),
        ({"center": [0, 0]}, "with space: 2 also {disc: radius, center: [x, y]} or {polygon: places}"),
        ({"polygon": [[0, 0], [1, 1]]}, "polygon: found a list of 2, expected a list of 3 to 64 places [x, y] (m)"),
        ({"polygon": [[0, 0], [1, "x"], [1, 1]]}, "polygon[1][1]: found 'x' (text), expected a number (m)"),
        ({"polygon": [[0, 0], [0.1, 0.1], ["10 cm", 0], [0, 0.1]]}, "polygon: found side 1 crossing side 3; expected"),
        ({"polygon": [[0, 0], [0.1, 0], [0, 0]]}, "polygon: found the first place again at the end"),
    ],
)
def test_a_travel_that_is_none_is_refused_at_its_place(travel: object, found: str) -> None:
    with pytest.raises(SceneError) as caught:
        planar(travel)
    assert found in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_area_needs_a_plane_and_the_channels_of_x_and_y_in_turn() -> None:
    with pytest.raises(
        SceneError, match=r"found a disc with hand on channels \[1, 0\], expected a list of pairs, one per"
    ):
        planar({"disc": 0.1}, (1, 0))
    assert len(planar([[-0.1, 0.1], [-0.2, 0.2]], (1, 0)).device.travels(2)) == 2
    line = document({"disc": 0.1}) | {"space": 1, "modules": {"hand": {"type": "device", "channel": 0}}}
    with pytest.raises(
        SceneError, match=r"found a disc in a scene with one coordinate, expected \[the least, the most\]"
    ):
        parse_scene(yaml.safe_dump(line))


def test_a_radius_in_mm_is_an_unlikely_one() -> None:
    assert "device.travel: found 80 m, more than 1 m" in unlikely(planar({"disc": 80}))[0]


def test_a_hand_that_starts_inside_a_shape_has_a_warning() -> None:
    def warned(
        position: list[float], side: str = "outside", between: tuple[str, str] = ("hand", "post"), **device: Any
    ) -> list[str]:
        shape = {"type": "shape", "between": list(between), "form": {"disc": 0.02}, "side": side, "stiffness": 2000}
        modules = {"post": {"type": "ground", "position": [0.03, 0.01]}, "disc": shape}
        mock = {"initial": {"position": position}}
        return list(begun_inside(planar(None, modules=modules, mock=mock, device=device)))

    (sentence,) = warned([0.03, 0.028])
    assert sentence.startswith("hand starts 2 mm inside disc: at arming the force jumps to 4 N. Let it start outside")
    assert warned([0.03, 0.0301]) == []
    assert "hand starts 0.1 mm inside disc" in warned([0.03, 0.0301], "inside")[0]
    assert "2 mm inside disc" in warned([0.03, 0.028], between=("post", "hand"))[0]
    assert "the force jumps to 10 N" in warned([0.03, 0.011])[0]
    assert warned([0.03, 0.028], soft_start=0.05) == []
    assert warned([0.03, 0.028], port="/dev/ttyACM0") == []
    (sentence,) = warned([0.03, 0.028], origin=[0.0, 0.01])
    assert sentence.startswith("hand starts 12 mm inside disc")
