"""Numbers with units in a scene: what people write, right and wrong, and what it is in SI units."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from decimal import Decimal
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from hapsim.errors import SceneError
from hapsim.scene import Device, Known, Mock, Scene, Span, parse_scene, scene_schema
from hapsim.scene.modules import MODULE_TYPES
from hapsim.scene.quantity import Expectation
from hapsim.scene.rewrite import device_rewritten
from hapsim.scene.written_units import QUANTITY, has_dimension, in_si
from hapsim.scene.yaml_document import FLOAT, INTEGER, compose
from hapsim.units import MOTIONS, Motion, Units, Written, complete

CONFIGS = Path(__file__).parents[2] / "configs"
SCENE = """\
version: 1
rate: 1000
device: {motion: linear, mass: 0.2, friction: 0, stiffness: 0, delay: 1}
mock: {quantum: 1e-6, force_quantum: 1e-6, noise: 0, turnaround: 0, misses: 0, initial: {velocity: 0}}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground, position: 0.0}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 0, damping: 0}
  slip:  {type: friction, between: [hand, wall], force: 0, stiffness: 1e3, damping: 0}
"""

#: Two hands of which the first has this motion, and the second the other.
TWO_HANDS = """version: 1
rate: 1000
device: {mass: 1, motion: [{motion}, {other}]}
modules:
  a: {type: device, channel: 0}
  b: {type: device, channel: 1}
  tie: {type: viscoelastic, between: [a, b], stiffness: 1, ratio: {written}}
"""


def touch(scene: Scene) -> Any:
    return scene.modules["touch"]


#: By the unit of a field in a linear scene: its text above, and its value in the model.
FIELDS: dict[str, tuple[str, Callable[[Scene], Any]]] = {
    "kg": ("mass: 0.2", lambda scene: scene.device.mass),
    "Hz": ("rate: 1000", lambda scene: scene.rate),
    "sample periods": ("delay: 1", lambda scene: scene.device.delay),
    "m": ("position: 0.0", lambda scene: scene.grounds["wall"].position),
    "m/s": ("velocity: 0", lambda scene: scene.mock and scene.mock.initial.velocity),
    "N/m": ("], stiffness: 0", lambda scene: touch(scene).stiffness),
    "N·s/m": ("], stiffness: 0, damping: 0", lambda scene: touch(scene).damping),
    "N": ("force: 0", lambda scene: scene.modules["slip"].force),  # type: ignore[attr-defined]
    "s": ("turnaround: 0", lambda scene: scene.mock and scene.mock.turnaround),
    "m per count": ("quantum: 1e-6", lambda scene: scene.mock and scene.mock.quantum),
    "N per count": ("force_quantum: 1e-6", lambda scene: scene.mock and scene.mock.force_quantum),
    "m/s²": ("misses: 0", lambda scene: scene.mock and scene.mock.acceleration_noise),
    "m rms": ("noise: 0", lambda scene: scene.mock and scene.mock.noise),
    "J": ("delay: 1", lambda scene: scene.device.energy_limit),
    "N/s": ("delay: 1", lambda scene: scene.device.slew_limit),
    "bit/s": ("delay: 1", lambda scene: scene.device.baud),
    "m/rad": ("", lambda scene: scene.modules["tie"].ratio),  # type: ignore[attr-defined]
    "1": ("misses: 0", lambda scene: scene.mock and scene.mock.misses),
}
KEYS = {"m/s²": "acceleration_noise", "J": "energy_limit", "N/s": "slew_limit", "bit/s": "baud"}


def scene_with(unit: str, written: str, motion: Motion) -> str:
    """The scene with a quantity in the field of this linear unit."""
    if unit == "m/rad":
        words = {"motion": motion, "other": "rotary" if motion == "linear" else "linear", "written": written}
        return reduce(lambda text, word: text.replace(f"{{{word}}}", words[word]), words, TWO_HANDS)
    old, _ = FIELDS[unit]
    key = KEYS.get(unit) or old.rpartition(":")[0]
    return SCENE.replace(old, f"{key}: {written}", 1).replace("motion: linear", f"motion: {motion}")


#: Field, motion, and what people write for one value in SI units, parted by "|".
RIGHT: list[tuple[str, Motion, float, str]] = [
    ("kg", "linear", 0.2, "200 g|200g|0.2 kg|.2 kg|2e-1 kg|200.0 g|+200 g|2.0e2 g|200000 mg|200 gram|200 grams"),
    ("kg", "linear", 0.0093, "9.3 g|0.0093 kg|9300 mg"),
    ("kg", "linear", 0.45359237, "1 lb|1 pound|16 oz"),
    ("kg", "rotary", 2e-5, "200 g·cm²|200 g*cm^2|200 g.cm²|200 gcm²|200 g cm2|2e-5 kg·m²|2e-5 kgm²|2e-5 kg m^2"),
    ("kg", "rotary", 3e-7, "3 g·cm²|0.3 kg·mm²|0.3 kg·mm^2|3e-7 kg.m2|300 g·mm²"),
    ("Hz", "linear", 2000.0, "2 kHz|2kHz|2000 Hz|2e3 Hz|0.002 MHz|2 kilohertz"),
    ("Hz", "linear", 48000.0, "48 kHz|48000.0 Hz"),
    ("sample periods", "linear", 1.5, "1.5 samples|1.5 sample|1.5samples|1.5 sample periods"),
    ("sample periods", "linear", 1.0, "1 sample|1 samples|1 sample period"),
    ("m", "linear", 0.005, "5 mm|5mm|0.5 cm|.5cm|5000 µm|5000 μm|5000 um|5e6 nm|0.005 m|5 millimetre|5e-3 m"),
    ("m", "linear", -0.05, "-50 mm|-5 cm|-0.05 m|-5.0e1 mm|-.05 metres"),
    ("m", "linear", 0.0254, "1 in|1 inch|2.54 cm"),
    ("m", "rotary", 0.5235987755982988, "30 deg|30deg|30°|30 °|30 degree|30 degrees|3.0e1 deg"),
    ("m", "rotary", 0.5, "0.5 rad|500 mrad|0.5 radian|.5rad"),
    ("m", "rotary", 6.283185307179586, "1 turn|1 rev|1 revolution"),
    ("m/s", "linear", 0.1, "100 mm/s|10 cm/s|0.1 m/s|0.1 m/sec|100 mm·s⁻¹|100 mm per s|0.1 m.s⁻¹"),
    ("m/s", "rotary", 0.17453292519943295, "10 deg/s|10°/s|10 ° / s|10 degrees/s"),
    ("m/s", "rotary", 6.283185307179586, "60 rpm|1 rev/s|1 turn/s"),
    ("N/m", "linear", 2000.0, "2 N/mm|2N/mm|2 N / mm|2 kN/m|20 N/cm|2000 N/m|2000 N·m⁻¹|2 N per mm|2 mN/µm|2e3 N/m"),
    ("N/m", "linear", 175.1268352464764, "1 lbf/in"),
    ("N/m", "rotary", 17.188733853924695, "0.3 N·m/deg|0.3 N.m/deg|0.3 Nm/deg|0.3 N*m/deg|300 mNm/deg|0.3 N⋅m/°"),
    ("N/m", "rotary", 0.3, "0.3 N·m/rad|0.3 Nm/rad|300 mN·m/rad|300 mNm/rad|30 Ncm/rad|300 Nmm/rad|0.3 N·m·rad⁻¹"),
    ("N·s/m", "linear", 5.0, "5 N·s/m|5 Ns/m|5 N*s/m|5 N.s/m|5 N s/m|5 N/(m/s)|0.005 N·s/mm|5 kg/s|5 N·s·m⁻¹"),
    ("N·s/m", "rotary", 0.002, "2 mN·m·s/rad|0.002 N·m·s/rad|0.002 Nms/rad|2 mNms/rad|0.002 N·m/(rad/s)"),
    ("N", "linear", 0.5, "500 mN|0.5 N|0.5N|5e-4 kN|0.5 newton|500000 µN|0.5 newtons"),
    ("N", "linear", 9.80665, "1 kgf|1000 gf"),
    ("N", "rotary", 0.05, "0.05 N·m|0.05 Nm|50 mN·m|50 mNm|50mNm|5 Ncm|5 N·cm|50 N·mm|50 Nmm|0.05 N*m"),
    ("s", "linear", 0.005, "5 ms|5ms|0.005 s|5000 µs|5000 us|5 milliseconds|5 msec"),
    ("m per count", "linear", 1e-05, "10 µm|10 µm/count|10 um per count|0.01 mm/count"),
    ("N per count", "linear", 0.001, "1 mN|1 mN/count|1 mN per count"),
    ("m rms", "linear", 2e-06, "2 µm|2 µm rms|2 um rms"),
    ("m/s²", "linear", 0.05, "0.05 m/s²|50 mm/s²|0.05 m/s^2|5 cm/s2"),
    ("J", "linear", 0.2, "200 mJ|0.2 J|0.2 N·m|200 mN·m|0.2 Nm|0.2 W·s"),
    ("N/s", "linear", 1000.0, "1 N/ms|1 kN/s|1000 N/s"),
    ("N/s", "rotary", 10.0, "10 N·m/s|10 mNm/ms"),
    ("m/rad", "linear", 0.03, "0.03 m/rad|30 mm/rad|3 cm/rad"),
    ("m/rad", "linear", 0.0031830988618379067, "20 mm/rev|2 cm per turn"),
    ("m/rad", "rotary", 33.0, "33 rad/m|0.033 rad/mm"),
    ("bit/s", "linear", 2000000, "2 Mbit/s|2000 kbit/s|2 MBd|2000000 bit/s|2000000 baud"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("unit", "motion", "value", "written"),
    [(unit, motion, value, one) for unit, motion, value, several in RIGHT for one in several.split("|")],
)
def test_what_people_write_is_a_number_in_si_units_to_the_last_bit(
    unit: str, motion: Motion, value: float, written: str
) -> None:
    scene = parse_scene(scene_with(unit, written, motion))
    _, get = FIELDS[unit]
    assert get(scene) == value
    assert type(get(scene)) is type(value)
    assert scene.model_dump() == parse_scene(scene_with(unit, repr(value), motion)).model_dump()


STIFFNESS = "expected a stiffness (N/m), such as 2000 N/m or 2 N/mm"
TORSION = "expected a stiffness (N·m/rad), such as 0.3 N·m/rad or 5 mN·m/deg"
LENGTH = "expected a length (m), such as 0.05 m or 50 mm"
ANGLE = "expected an angle (rad), such as 0.5 rad or 30 deg"
MASS = "expected a mass (kg), such as 0.2 kg or 200 g"
INERTIA = "expected a moment of inertia (kg·m²), such as 2e-5 kg·m² or 200 g·cm²"
DAMPING = "expected a damping (N·s/m), such as 5 N·s/m or 0.005 N·s/mm"
ROTARY = ", or device.motion: rotary"
SAMPLES = "expected a number of samples (sample periods), such as 1 sample or 1.5 samples"
FREQUENCY = "expected a frequency (Hz), such as 1000 Hz or 1 kHz"
TURNING_DAMPING = "expected a damping (N·m·s/rad), such as 0.002 N·m·s/rad or 2 mN·m·s/rad"
NO_UNIT = "expected a number from 0 to 1 (1); write plain decimals without a unit, such as 2000, 0.5 or 1e-9"

#: Field, motion, what people write, and the sentence after the name of the key.
WRONG: list[tuple[str, Motion, str, str]] = [
    ("N/m", "linear", "2 N", f"found 2 N, {STIFFNESS}"),
    ("N/m", "linear", "2 N/m²", f"found 2 N/m², {STIFFNESS}"),
    ("N/m", "linear", "0.3 N·m/rad", f"found 0.3 N·m/rad, {STIFFNESS}{ROTARY}"),
    ("N/m", "linear", "2 dog", f"found 2 dog, with the unknown unit 'dog', {STIFFNESS}; did you mean 'deg'?"),
    ("N/m", "linear", "2 n/mm", f"found 2 n/mm, with the unknown unit 'n', {STIFFNESS}; did you mean 'N'?"),
    ("N/m", "linear", "2.nan", f"found 2.nan, with the unknown unit 'nan', {STIFFNESS}"),
    ("N/m", "linear", "2 mdB/m", f"found 2 mdB/m, with the unknown unit 'mdB', {STIFFNESS}"),
    ("N/m", "linear", "2 N/(m", f"found 2 N/(m, with the unknown unit 'N/(m', {STIFFNESS}"),
    ("N/m", "linear", "2 N/m or so", f"found 2 N/m or so, with the unknown unit 'or', {STIFFNESS}"),
    ("N/m", "linear", "2 gf-m/s²", f"found 2 gf-m/s², with the unknown unit 'gf-m/s²', {STIFFNESS}"),
    ("N/m", "linear", "-2 N/mm", "found -2 N/mm, expected a number >= 0 (N/m)"),
    ("N/m", "linear", "nan N/m", "found nan N/m, expected a finite number (N/m)"),
    ("N/m", "linear", ".inf N/m", "found .inf N/m, expected a finite number (N/m)"),
    ("N/m", "linear", "1e308 N/mm", "found 1e308 N/mm, expected a finite number (N/m)"),
    ("N/m", "linear", "'2000'", "found '2000' (text), expected a number >= 0 (N/m); remove the quotes"),
    ("N/m", "linear", "N/m", "found 'N/m' (text), expected a number >= 0 (N/m)"),
    ("N/m", "rotary", "2 N/mm", f"found 2 N/mm, {TORSION}"),
    ("N/m", "rotary", "2 Nm/red", f"found 2 Nm/red, with the unknown unit 'red', {TORSION}; did you mean 'rev'?"),
    ("m", "linear", "5 kg", f"found 5 kg, {LENGTH}"),
    ("m", "linear", "30 deg", f"found 30 deg, {LENGTH}{ROTARY}"),
    ("J", "linear", "'0,5 mJ'", "found '0,5 mJ' (text), expected a number > 0 (J); write a decimal point: 0.5 mJ"),
    ("m", "linear", "5 ½m", f"found 5 ½m, with the unknown unit '½m', {LENGTH}"),
    ("m", "rotary", "10 mm", f"found 10 mm, {ANGLE}"),
    ("m", "rotary", "nan deg", "found nan deg, expected a finite number (rad; or such as 15 deg)"),
    ("m/s", "rotary", "-10 deg", "found -10 deg, expected an angular velocity (rad/s), such as 2 rad/s or 90 deg/s"),
    ("kg", "linear", "200 g·cm²", f"found 200 g·cm², {MASS}{ROTARY}"),
    ("kg", "linear", "1 KG", f"found 1 KG, with the unknown unit 'KG', {MASS}; did you mean 'kg'?"),
    ("kg", "linear", "0 g", "found 0 g, expected a number > 0 (kg)"),
    ("kg", "linear", "0x1F kg", "found '0x1F kg' (text), expected a number > 0 (kg), or {from: "),
    ("kg", "rotary", "200 g", f"found 200 g, {INERTIA}"),
    ("N", "linear", "1 N·m", f"found 1 N·m, expected a force (N), such as 2 N or 500 mN{ROTARY}"),
    ("N", "rotary", "1 N", "found 1 N, expected a torque (N·m), such as 0.05 N·m or 50 mN·m"),
    ("N·s/m", "linear", "5 N/m", f"found 5 N/m, {DAMPING}"),
    ("N·s/m", "rotary", "5 N·m·s", f"found 5 N·m·s, {TURNING_DAMPING}"),
    ("Hz", "linear", "1 khz", f"found 1 khz, with the unknown unit 'khz', {FREQUENCY}; did you mean 'kHz'?"),
    ("Hz", "linear", "60 rpm", f"found 60 rpm, {FREQUENCY}"),
    ("sample periods", "linear", "1 ms", f"found 1 ms, {SAMPLES}"),
    ("s", "linear", "2 s", "found 2 s, expected a number from 0 to 1 (s)"),
    ("s", "linear", "1 sample", "found 1 sample, expected a time (s), such as 0.005 s or 5 ms"),
    ("bit/s", "linear", "2.3 bit/s", "found 2.3 bit/s, expected a whole number from 1 to 100000000 (bit/s)"),
    ("bit/s", "linear", "2 Mbit", "found 2 Mbit, expected a bit rate (bit/s), such as 2000000 bit/s or 2 Mbit/s"),
    ("1", "linear", "5 %", f"found 5 %, {NO_UNIT}"),
]  # fmt: skip


@pytest.mark.parametrize(("unit", "motion", "written", "sentence"), WRONG)
def test_what_is_wrong_is_a_sentence_with_its_place(unit: str, motion: Motion, written: str, sentence: str) -> None:
    text = scene_with(unit, written, motion)
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "scene.yaml")
    (line,) = str(caught.value).splitlines()
    place, _, said = line.partition(": ")
    at = text.index(f": {written}") + 2
    assert place == f"scene.yaml:{text[:at].count(chr(10)) + 1}:{at - text.rfind(chr(10), 0, at)}"
    assert said.partition(": ")[2].startswith(sentence)
    assert said.endswith(sentence) or "{from: " in sentence


def test_units_stand_in_lists_tables_spans_and_uncertainties() -> None:
    scene = parse_scene(
        "version: 1\nrate: 1 kHz\n"
        "device: {mass: [200 g, {value: 300 g, uncertainty: 1 g}, {from: 100 g, to: 0.4}], origin: [5 mm, here, 0.1],\n"
        "         travel: [[-50 mm, 5 cm], [-1, 1], [-1 mm, 1]], correction: predictor}\n"
        "mock: {grips: [[0, 200 g], [500 ms, 0.3]]}\n"
        "modules:\n  a: {type: device, channel: 0}\n  b: {type: device, channel: 1}\n  c: {type: device, channel: 2}\n"
        "  w: {type: nonlinear, between: [a, b], force_over_distance: [[-1 mm, -500 mN], [0, 0], [2 cm, 1]]}\n"
    )
    device = scene.device
    assert device.mass == (0.2, Known(value=0.3, uncertainty=0.001), Span(least=0.1, most=0.4))
    assert device.origin == (0.005, "here", 0.1)
    assert device.travel == ((-0.05, 0.05), (-1.0, 1.0), (-0.001, 1.0))
    assert scene.mock is not None
    assert scene.mock.grips == ((0.0, 0.2), (0.5, 0.3))
    assert scene.modules["w"].force_over_distance == ((-0.001, -0.5), (0.0, 0.0), (0.02, 1.0))  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("unit", "motion", "written", "shown"),
    [
        ("m", "rotary", "30 degrees", {"m": "2°", "mm": "2°", "µm": "2°", "m/s": "2°/s", "N/m": "2 N·m/rad"}),
        ("m", "rotary", "500 mrad", {"m": "2 mrad", "µm": "2 mrad"}),
        ("m", "rotary", "0.5 rad", {"m": "2 rad", "mm": "2 mrad"}),
        ("N/m", "rotary", "0.3 Nm/deg", {"N/m": "2 Nm/deg", "m": "2 rad", "N·s/m": "2 Nm·s/deg"}),
        ("N·s/m", "rotary", "2 mN·m·s/rad", {"N·s/m": "2 mN·m·s/rad", "N/m": "2 mN·m/rad", "N": "2 N·m"}),
        ("N·s/m", "linear", "2 g/s", {"N·s/m": "2 g/s", "N/m": "2 N/m"}),
        ("m", "linear", "3 in", {"m": "2 in", "mm": "2 in", "µm": "2 µm", "m/s": "2 in/s", "m/s²": "2 in/s²"}),
        ("kg", "linear", "200 g", {"kg": "2 g", "N": "2 N"}),
        ("N", "linear", "2 ozf", {"N": "2 ozf", "mN": "2 ozf", "µN": "2 µN"}),
        ("N·s/m", "linear", "2 N·s/m", {"N·s/m": "2 N·s/m"}),
    ],
)
def test_reports_are_in_the_units_of_the_file(unit: str, motion: Motion, written: str, shown: dict[str, str]) -> None:
    units = parse_scene(scene_with(unit, written, motion)).units
    for asked, words in shown.items():
        assert units("2", asked) == words
    asked = next(iter(shown))
    assert in_si(units(1.25, asked), asked, [motion]) == pytest.approx(1.25, rel=1e-5)
    assert units.si.written == ()


def test_large_numbers_have_no_exponent() -> None:
    units = parse_scene(scene_with("N", "500 mN", "linear")).units
    assert (units(4.0123, "N", 3), units(-23.5, "N", "+.2g")) == ("4010 mN", "-24000 mN")
    assert (units(4.0, "N", "+.1g"), units(2e3, "N", 3), units(4e-6, "N", 3)) == ("+4000 mN", "2e+06 mN", "0.004 mN")


def test_an_angle_of_a_rotary_module_is_no_unit_of_a_linear_one() -> None:
    text = scene_with("m", "3 deg", "linear").replace("motion: linear", "motion: [linear, rotary]")
    more = "  knob: {type: device, channel: 1}\n  turn: {type: viscoelastic, between: [knob, wall], stiffness: 1}\n"
    text = text.replace("[hand, wall]", "[hand, floor]").replace("  slip:", f"{more}  floor: {{type: ground}}\n  slip:")
    scene = parse_scene(text)
    assert [scene.units_of(channel).name("m") for channel in (0, 1)] == ["m", "°"]


def test_the_first_unit_of_a_quantity_counts() -> None:
    text = scene_with("m", "30 mm", "linear")
    for unit, first in (("20 cm", "cm"), ("0.2", "mm"), ("0.2 m", "mm")):
        both = text.replace("initial: {velocity: 0}", f"initial: {{position: {unit}}}")
        assert parse_scene(both).units.name("m") == first


def test_python_takes_si_numbers_alone() -> None:
    with pytest.raises(ValueError, match="expected a number > 0"):
        Device(mass="200 g")  # type: ignore[arg-type]


def units_of(part: type) -> Iterator[str]:
    for field in part.model_fields.values():  # type: ignore[attr-defined]
        for expectation in (one for one in field.metadata if isinstance(one, Expectation)):
            yield from filter(has_dimension, expectation.units)


def test_every_unit_of_a_scene_has_an_example_that_is_read_as_it() -> None:
    parts = (Scene, Device, Mock, *MODULE_TYPES.values())
    units = {unit for part in parts for unit in units_of(part)}
    assert len(units) > 12
    for unit in units:
        for motion in MOTIONS:
            said = Units.of([motion]).filled(f"‹one {unit}›")
            assert f"({Units.of([motion]).name(unit)}), such as " in said
            for example in said.rpartition(", such as ")[2].split(" or "):
                parse_scene(scene_with(unit, example, motion))


def test_the_schema_takes_a_unit_where_the_field_has_one() -> None:
    schema = Draft202012Validator(scene_schema())
    for unit, motion, _, several in RIGHT:
        assert list(schema.iter_errors(yaml.safe_load(scene_with(unit, several.split("|")[0], motion)))) == []
    for wrong in (
        scene_with("1", "2 N/mm", "linear"),
        scene_with("kg", "kg", "linear"),
        scene_with("kg", "'2'", "linear"),
    ):
        assert list(schema.iter_errors(yaml.safe_load(wrong))) != []


#: By the unit of a field: another, and the power of ten that it takes.
OTHERS = {
    "kg": ("g", 3), "kg·m²": ("g·cm²", 7), "m": ("mm", 3), "rad": ("mrad", 3), "m/s": ("mm/s", 3),
    "rad/s": ("mrad/s", 3), "N": ("mN", 3), "N·m": ("mN·m", 3), "N/m": ("N/mm", -3), "N·m/rad": ("mNm/rad", 3),
    "N·s/m": ("mN·s/m", 3), "m/s²": ("mm/s²", 3), "rad/s²": ("mrad/s²", 3),
    "N·m·s/rad": ("mNm·s/rad", 3), "Hz": ("kHz", -3), "s": ("ms", 3), "J": ("mJ", 3), "N/s": ("kN/s", -3),
    "N·m/s": ("mNm/s", 3), "bit/s": ("kbit/s", -3), "sample periods": ("samples", 0), "m per count": ("µm", 6),
    "rad per count": ("mrad/count", 3), "N per count": ("mN", 3), "m rms": ("µm rms", 6), "rad rms": ("mrad", 3),
}  # fmt: skip


def with_units(text: str) -> tuple[str, int]:
    """A scene's text with a unit behind every number that has a dimension, and how many there are."""
    from hapsim.scene.load import _LAYOUT, _sound_modules, _units_by_path
    from hapsim.scene.yaml_document import Document

    root = compose(text)
    assert root is not None
    data: Any = Document(root).data
    units = _units_by_path(data, _sound_modules(data["modules"]), ())(())
    edits: dict[int, tuple[int, str]] = {}

    def walk(node: yaml.Node, path: tuple[str | int, ...]) -> None:
        if isinstance(node, yaml.ScalarNode):
            unit = _LAYOUT.unit(path, data) if node.tag in (INTEGER, FLOAT) else ""
            if unit:
                other, power = OTHERS[units.name(unit)]
                number = f"{Decimal(node.value).scaleb(power)} {other}"
                edits[node.start_mark.index] = (node.end_mark.index, number)
        else:
            keys = ((key.value, value) for key, value in node.value) if isinstance(node, yaml.MappingNode) else None
            for step, value in keys or enumerate(node.value):
                walk(value, (*path, step))

    walk(root, ())
    for begin in sorted(edits, reverse=True):
        end, number = edits[begin]
        text = text[:begin] + number + text[end:]
    return text, len(edits)


@pytest.mark.parametrize(
    "path", [*CONFIGS.glob("*.yaml"), *(CONFIGS / "boards").glob("*.yaml")], ids=lambda path: path.stem
)
def test_a_shipped_scene_with_units_is_the_same_to_the_last_bit(path: Path) -> None:
    text = path.read_text("utf-8")
    written, count = with_units(text)
    assert count >= 4
    assert parse_scene(written).model_dump() == parse_scene(text).model_dump()


@pytest.mark.thorough
def test_pint_is_loaded_for_a_unit_alone(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    program = (
        "import contextlib, sys\nfrom hapsim.cli import main\n"
        "with contextlib.suppress(SystemExit): main()\n"
        "print('pint' in sys.modules, file=sys.stderr)"
    )

    def check(text: str) -> tuple[str, str]:
        path.write_text(text, "utf-8")
        words = [sys.executable, "-c", program, "check", path, "--at=0.001", "--hand-mass=0.1:2", "--json"]
        done = subprocess.run(words, check=True, capture_output=True, text=True)
        return done.stdout, done.stderr.splitlines()[-1]

    plain, loaded = check((CONFIGS / "first_touch.yaml").read_text("utf-8"))
    assert loaded == "False"
    assert '"stable": true' in plain
    assert check((CONFIGS / "knob_24.yaml").read_text("utf-8"))[1] == "False"  # plain angles
    assert check(with_units((CONFIGS / "first_touch.yaml").read_text("utf-8"))[0]) == (plain, "True")


def test_what_is_written_back_keeps_the_unit_that_stood_there() -> None:
    text = SCENE.replace("mass: 0.2", "mass: 200 g").replace("friction: 0,", "friction: 500 mN·s/m,  # of the rail\n ")
    text = text.replace("delay: 1", "delay: 1 sample")
    values = {"mass": Known(value=0.20345, uncertainty=1.1e-5), "friction": "0.98", "delay": "1.0213", "stiffness": "3"}
    new = device_rewritten(text, values, 0)
    assert "mass: {value: 203.45 g, uncertainty: 0.011 g}, friction: 980 mN·s/m,  # of the rail\n" in new
    assert "stiffness: 3, delay: 1.0213 sample}" in new
    assert "mass: {value: 300 g, uncertainty: 2 g}," in device_rewritten(
        new, {"mass": Known(value=0.3, uncertainty=0.002)}, 0
    )
    pounds = text.replace("200 g", "1 lb")
    assert "mass: 0.4409245243697552 lb, " in device_rewritten(pounds, {"mass": "0.2"}, 0)
    two = text.replace("mass: 200 g", "mass: [200 g, 0.3 kg]").replace(
        "  wall", "  more: {type: device, channel: 1}\n  wall"
    )
    assert "mass: [200 g, 0.25 kg], friction: [500 mN·s/m, 100 mN·s/m]," in device_rewritten(
        two, {"mass": "0.25", "friction": "0.1"}, 1
    )


def test_no_text_of_units_ends_in_another_error() -> None:
    pieces = ["N", "m", "·", "/", "(", ")", "²", "^2", "**", ".", "⁻¹", "-", "per ", "deg", "½", "é", " ", "1"]
    texts = {f"2 {a}{b}{c}" for a in pieces for b in pieces for c in pieces}
    written = [*filter(QUANTITY.match, sorted(texts))]
    assert len(written) > 2000
    for at in range(0, len(written), 50):
        places = "".join(
            f'  place{i}: {{type: ground, position: "{text}"}}\n' for i, text in enumerate(written[at : at + 50])
        )
        with pytest.raises(SceneError, match="position: found 2"):
            parse_scene(f"{SCENE}{places}")


def test_a_torque_in_a_unit_of_energy_is_read_and_reported_as_a_torque() -> None:
    units = Units.of(["rotary"], complete([Written("N·m", "mJ", 1e3), Written("J", "mJ", 1e3)]))
    assert (units(5e-4, "N"), units(5e-4, "J")) == ("0.5 mN·m", "0.5 mJ")
