"""Contents of a scene, its derived values, and its immutability."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml
from pydantic import ValidationError

from hapsim.cordis.program import PART_TYPES
from hapsim.cordis.schemes import SCHEMES
from hapsim.dampers import DAMPERS
from hapsim.device.mock import sampler
from hapsim.holds import HOLDS
from hapsim.scene import (
    DamperScheme,
    Device,
    DevicePoint,
    Ground,
    Hold,
    Initial,
    Mass,
    Mock,
    MockDevice,
    Sampling,
    Scene,
    SchemeName,
    ViscoElastic,
    choices,
    parse_scene,
)
from hapsim.scene.drive import Drive
from hapsim.scene.modules import MODULE_TYPES
from hapsim.theory import interface
from hapsim.theory.schemes import SCHEMES as THEORY

TEXT = """\
version: 1
rate: 500
device:
  port: /dev/ttyACM0
  mass: [0.2, 0.3]
  friction: 1.0
  delay: 0.5
mock:
  friction: [2.0, 3.0]
  hold: impulse
  initial: {position: 0.01, velocity: [0.1, 0.2]}
  quantum: 1e-6
  force_quantum: 0.01
modules:
  right: {type: device, channel: 1}
  wall:  {type: ground, position: -0.1}
  grip:  {type: viscoelastic, between: [left, m1], stiffness: 100, damping: 1}
  m1:    {type: mass, mass: 0.01, velocity: 2}
  touch: {type: viscoelastic, between: [right, wall], stiffness: 0}
  left:  {type: device, channel: 0}
"""


def test_a_scene_has_its_modules_by_kind_in_the_order_of_the_file() -> None:
    scene = parse_scene(TEXT)
    assert list(scene.modules) == ["right", "wall", "grip", "m1", "touch", "left"]
    assert scene.device_points == {"right": DevicePoint(channel=1), "left": DevicePoint(channel=0)}
    assert list(scene.device_points) == ["right", "left"]
    assert scene.grounds == {"wall": Ground(position=-0.1)}
    assert scene.masses == {"m1": Mass(mass=0.01, velocity=2.0)}
    assert scene.links == {
        "grip": ViscoElastic(between=("left", "m1"), stiffness=100.0, damping=1.0),
        "touch": ViscoElastic(between=("right", "wall"), stiffness=0.0),
    }


def test_what_is_left_out_has_the_defaults_of_the_format(good: str) -> None:
    scene = parse_scene(good)
    assert scene.device == Device(
        port=None,
        baud=2_000_000,
        clock="device",
        mass=0.2,
        friction=0.0,
        stiffness=0.0,
        delay=1.0,
        hold="zoh",
        sampling="ideal",
        force_limit=10.0,
    )
    assert scene.mock is None
    assert scene.links["touch"] == ViscoElastic(
        between=("hand", "wall"), stiffness=2000.0, damping=0.0, damper="backward", cutoff=None
    )
    mock = scene.mock_device
    assert (mock.mass, mock.initial_position, mock.initial_velocity) == ((0.2,), (0.0,), (0.0,))
    assert (mock.quantum, mock.force_quantum, mock.baud) == ((1e-9,) * mock.channels, None, None)


def test_the_mock_has_the_values_of_the_device_where_it_has_none_of_its_own() -> None:
    assert parse_scene(TEXT).mock_device == MockDevice(
        mass=(0.2, 0.3),
        friction=(2.0, 3.0),
        stiffness=(0.0, 0.0),
        delay=0.5,
        hold="impulse",
        sampling="ideal",
        initial_position=(0.01, 0.01),
        initial_velocity=(0.1, 0.2),
        force_limit=10.0,
        coulomb=0.0,
        quantum=(1e-6, 1e-6),
        noise=0.0,
        seed=0,
        force_quantum=0.01,
        drive=(Drive(), Drive()),
        servo=(None, None),
    )


def test_the_device_has_one_channel_more_than_the_highest_that_is_held(good: str) -> None:
    assert parse_scene(good).channels == 1
    assert parse_scene(good.replace("channel: 0", "channel: 3")).channels == 4
    assert parse_scene(TEXT).channels == 2
    assert parse_scene(TEXT).device.masses(2) == (0.2, 0.3)
    assert parse_scene(TEXT).device.frictions(2) == (1.0, 1.0)
    assert parse_scene(TEXT).mock_device.channels == 2


def test_nothing_in_a_scene_can_be_changed() -> None:
    scene = parse_scene(TEXT)
    for part, field in [(scene, "rate"), (scene.device, "mass"), (scene.modules["m1"], "mass")]:
        with pytest.raises(ValidationError, match="frozen"):
            setattr(part, field, 1.0)
    with pytest.raises(TypeError):
        scene.modules["m1"] = Mass(mass=1.0)  # type: ignore[index]
    scene.masses.clear()
    assert list(scene.masses) == ["m1"]
    with pytest.raises(AttributeError):
        scene.mock_device.delay = 1.0  # type: ignore[misc]


def test_equal_texts_make_equal_scenes_that_can_be_copied_and_hashed() -> None:
    scene = parse_scene(TEXT)
    assert parse_scene(TEXT) == scene
    assert hash(parse_scene(TEXT)) == hash(scene)
    assert copy.deepcopy(scene) == scene
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert parse_scene(TEXT.replace("500", "501")) != scene


def test_a_scene_written_out_reads_back_the_same() -> None:
    scene = parse_scene(TEXT)
    assert Scene.model_validate(scene.model_dump()) == scene
    assert Scene.model_validate_json(scene.model_dump_json()) == scene
    assert parse_scene(yaml.safe_dump(scene.model_dump(mode="json", exclude_none=True))) == scene


def test_a_scene_made_in_python_goes_through_the_same_checks() -> None:
    modules: dict[str, Any] = {"hand": DevicePoint(channel=0), "wall": Ground()}
    touch = ViscoElastic(between=("hand", "wall"), stiffness=1.0)
    mock = Mock(initial=Initial(velocity=0.1))
    scene = Scene(version=1, rate=1000, device=Device(mass=0.2), mock=mock, modules={**modules, "touch": touch})
    assert scene.mock_device.initial_velocity == (0.1,)
    with pytest.raises(ValidationError, match="did you mean 'wall'"):
        Scene(
            version=1,
            rate=1000,
            device=Device(mass=0.2),
            modules={**modules, "touch": ViscoElastic(between=("hand", "wal"), stiffness=1.0)},
        )
    with pytest.raises(ValidationError, match=r"expected a number > 0 \(kg\)"):
        Device(mass=True)


def test_naming_the_room_loads_neither_yaml_nor_pydantic_nor_anything_heavy() -> None:
    check = (
        "import sys, hapsim.scene; "
        "assert not {'yaml', 'pydantic', 'numpy'} & set(sys.modules); "
        "hapsim.scene.load_scene; "
        "assert not {'numpy', 'numba', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", check], check=True)


def test_the_module_offers_its_public_names_and_nothing_else() -> None:
    import hapsim.scene

    assert all(hasattr(hapsim.scene, name) for name in hapsim.scene.__all__)
    with pytest.raises(AttributeError, match="no attribute 'load_secne'"):
        hapsim.scene.load_secne  # noqa: B018


def test_the_device_may_have_a_spring_of_its_own(good: str) -> None:
    text = good.replace("{mass: 0.2}", "{mass: 0.2, stiffness: 30}")
    assert parse_scene(text).device.stiffnesses(1) == (30.0,)
    assert parse_scene(text).mock_device.stiffness == (30.0,)
    assert parse_scene(text + "mock: {stiffness: 0}\n").mock_device.stiffness == (0.0,)


def test_every_scheme_that_is_offered_is_known_to_kernel_and_theory() -> None:
    assert set(get_args(SchemeName)) <= set(SCHEMES) <= set(THEORY)


def test_what_a_device_can_do_is_known_to_theory_and_mock() -> None:
    assert get_args(Hold) == tuple(HOLDS)
    assert get_args(Sampling) == tuple(interface.SAMPLINGS) == tuple(sampler.SAMPLINGS)


def test_every_damper_is_known_to_theory_and_kernel(good: str) -> None:
    assert get_args(DamperScheme) == tuple(DAMPERS)
    for name in get_args(DamperScheme):
        cutoff = 80.0 if name in choices.WITH_CUTOFF else None
        assert interface.damper_named(name, cutoff, 500.0).senses == (name in choices.WITH_SENSOR)
        damper = f"damper: {name}" + ("" if cutoff is None else f", cutoff: {cutoff}")
        scene = parse_scene(good.replace("stiffness: 2000", f"stiffness: 2000, {damper}"))
        assert [kind.name for kind in PART_TYPES if "touch" in kind.select(scene)] != [], name


@pytest.mark.parametrize("words", [Hold, Sampling, DamperScheme, SchemeName], ids=str)
def test_every_choice_is_described_in_the_schema_and_to_people(words: Any) -> None:
    told = Path("configs/README.md").read_text(encoding="utf-8")
    described = " ".join((choices.HOLD, choices.SAMPLING, choices.DAMPER, choices.SCHEME))
    for name in get_args(words):
        assert f"`{name}`" in told
        assert f"({name})" in described


def test_every_type_of_module_has_its_heading() -> None:
    told = Path("hapsim/cordis/MODULES.md").read_text(encoding="utf-8")
    for name in MODULE_TYPES:
        assert f"`{name}`" in Path("configs/README.md").read_text(encoding="utf-8")
        assert f"\n## {name}\n" in told
        assert f"(#{name})" in told
