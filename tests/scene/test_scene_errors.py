"""The error of a faulty value or key names line and column, what was found and what was expected."""

from collections.abc import Callable, Iterator
from typing import get_args

import pytest
from pydantic import BaseModel

from hapsim.scene import Device, Hand, Hold, Initial, Mock, Scene, SchemeName
from hapsim.scene.issue import one_of
from hapsim.scene.modules import MODULE_TYPES

OnlyFault = Callable[[str, str], str]
Faults = Callable[[str], list[str]]

HZ = "expected a number > 0 (Hz)"
FINITE = "expected a finite number > 0 (Hz)"
DECIMALS = "; write plain decimals, such as 2000, 0.5 or 1e-9"
MAPPINGS = "{from: the least, to: the most}, or {value: a number, uncertainty: its standard uncertainty}"
MASS = f"expected a number > 0 (kg), or {MAPPINGS}, or a list with one per channel, or a symmetric matrix"
LIMITS = "[the least, the most] (m)"
AREAS = "with space: 2 also {disc: radius, center: [x, y]} or {polygon: places}"
PORT = "expected the name of a serial port, such as /dev/ttyACM0, or an address"
TYPES = f"expected {one_of(MODULE_TYPES)}"
NAME = "not a name, expected letters, digits, _ and -, starting with a letter or _"
NO_TAG = "expected a plain value without a tag"


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("-3", f"2:7: rate: found -3, {HZ}"),
        ("fast", f"2:7: rate: found 'fast' (text), {HZ}"),
        ("'1000'", f"2:7: rate: found '1000' (text), {HZ}; remove the quotes"),
        ("1_000", f"2:7: rate: found '1_000' (text), {HZ}{DECIMALS}"),
        ("2 000", f"2:7: rate: found '2 000' (text), {HZ}; remove the space: 2000"),
        ("1 200.5 Hz", f"2:7: rate: found '1 200.5 Hz' (text), {HZ}; remove the space: 1200.5 Hz"),
        ("010", f"2:7: rate: found '010' (text), {HZ}{DECIMALS}"),
        ("0x1F", f"2:7: rate: found '0x1F' (text), {HZ}{DECIMALS}"),
        ("true", f"2:7: rate: found true (a boolean), {HZ}"),
        (".nan", f"2:7: rate: found .nan, {FINITE}"),
        ("1e400", f"2:7: rate: found 1e400, {FINITE}"),
        ("9" * 5000, f"2:7: rate: found {'9' * 24}… (5000 characters), {FINITE}"),
        ("", f"2:7: rate: found nothing, {HZ}"),
        ("[1000]", f"2:7: rate: found a list, {HZ}"),
        ("{}", f"2:7: rate: found an empty mapping, {HZ}"),
        ("!!int 1e3", f"2:7: found '1e3' with the tag '!!int', {NO_TAG}"),
        ("!hz 1000", f"2:7: found '1000' with the tag '!hz', {NO_TAG}"),
    ],
)
def test_what_is_no_rate_is_reported_as_the_file_spells_it(only_fault: OnlyFault, value: str, told: str) -> None:
    # The empty value stands where the colon ends, one column before the others.
    assert only_fault("rate: 1000", f"rate: {value}") == (told if value else told.replace("2:7", "2:6"))


@pytest.mark.parametrize(
    ("device", "told"),
    [
        ("{mass: no}", f"3:16: mass: found 'no' (text), {MASS}"),
        ("{mass: [-1]}", "3:17: mass[0]: found -1, expected a number > 0 (kg)"),
        (
            "{mass: 1, hold: zho}",
            f"3:25: hold: found 'zho' (text), expected {one_of(get_args(Hold))}; did you mean 'zoh'?",
        ),
        ("{mass: 1, clock: 3}", "3:26: clock: found 3, expected device, host or lockstep"),
        ("{mass: 1, port: 3}", f"3:25: port: found 3, {PORT}"),
        ("{mass: 1, port: ''}", f"3:25: port: found '' (text), {PORT}"),
        ("{mass: {value: 0.2}}", f"3:16: mass: found a mapping, {MASS}"),
        ("{mass: [{value: 1, uncertainty: 0}]}", "3:41: uncertainty: found 0, expected a number > 0 (kg)"),
        (
            "{mass: {value: 0.2, uncertainty: 0.3}}",
            "3:16: mass: found a mapping, expected uncertainty (0.3) below value (0.2)",
        ),
        ("{mass: {from: 1, to: 1}}", "3:16: mass: found a mapping, expected from (1) below to (1)"),
        (
            "{mass: 1, travel: 0.1}",
            f"3:27: travel: found 0.1, expected {LIMITS}, or a list of such pairs, one per channel; {AREAS}",
        ),
        ("{mass: 1, travel: [0, 1, 2]}", f"3:27: travel: found a list of 3, expected {LIMITS}"),
        ("{mass: 1, travel: [0.1, 0.1]}", "3:27: travel: found a list, expected two different limits"),
        ("{mass: 1, travel: [9 mm, -1]}", "3:27: travel: found a list, expected the least before the most; swap them"),
        ("{mass: 1, travel: [[0, 1], 2]}", f"3:36: travel[1]: found 2, expected {LIMITS}"),
        (
            "{mass: 1, travel: [[0, 1], [0, 1]]}",
            "3:27: travel: found 2 pairs, expected 1: one for each channel, up to the highest that a module holds; or "
            "write a single pair for all",
        ),
        (
            "{mass: 1, travel_margin: 0.01}",
            "3:19: travel_margin: found a margin without a travel; add device.travel: [the least, the most], or "
            "omit the margin",
        ),
        (
            "{mass: 1, origin: there}",
            "3:27: origin: found 'there' (text), expected a number (m), or here, or a list with one per channel",
        ),
        ("3", "3:9: device: found 3, expected a mapping"),
        ("", "3:8: device: found nothing, expected a mapping"),
        ("{}", f"3:1: device: 'mass' is missing, {MASS}"),
        ("!!python/object:os.system {mass: 1}", f"3:9: found the tag '!!python/object:os.system', {NO_TAG}"),
    ],
)
def test_what_does_not_describe_a_device_is_reported(only_fault: OnlyFault, device: str, told: str) -> None:
    assert only_fault("{mass: 0.2}", device) == told


@pytest.mark.parametrize(
    ("mock", "told"),
    [
        ("{baud: 9600.5}", "3:14: baud: found 9600.5, expected a whole number from 1 to 100000000 (bit/s)"),
        ("{noise: true}", "3:15: noise: found true (a boolean), expected a number >= 0 (m rms)"),
        ("{seed: 1.5}", "3:14: seed: found 1.5, expected a whole number from 0 to 4294967295"),
        ("{initial: {speed: 1}}", "3:18: speed: unknown key, expected position or velocity"),
        ("[]", "3:7: mock: found an empty list, expected a mapping"),
    ],
)
def test_what_does_not_describe_a_mock_is_reported(only_fault: OnlyFault, mock: str, told: str) -> None:
    assert only_fault("rate: 1000\n", f"rate: 1000\nmock: {mock}\n") == told


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("channel: 0", "channel: 0.0", "5:34: channel: found 0.0, expected a whole number from 0 to 15"),
        ("type: ground", "type: grund", f"6:17: type: found 'grund' (text), {TYPES}; did you mean 'ground'?"),
        ("type: ground", "type: [ground]", f"6:17: type: found a list, {TYPES}"),
        (
            "{type: ground}",
            "ground",
            "6:10: wall: found 'ground' (text), expected a mapping such as {type: mass, mass: 0.01}",
        ),
        ("type: ground", "typ: ground", f"6:3: wall: 'type' is missing, {TYPES}; is 'typ' meant to be 'type'?"),
        ("{type: ground}", "{}", f"6:3: wall: 'type' is missing, {TYPES}"),
        (", stiffness: 2000", "", "7:3: touch: 'stiffness' is missing, expected a number >= 0 (N/m)"),
        (
            "stiffness: 2000",
            "Stiffness: 2000",
            "7:54: Stiffness: unknown key, expected type, between, when, stiffness, damping, damper, cutoff, length, "
            "gain or ratio; did you mean 'stiffness'?",
        ),
        (
            "stiffness: 2000",
            "stiffness: 2000, damper: filtered",
            "7:79: damper: found filtered without a cutoff, expected cutoff: a number > 0 (Hz) too",
        ),
        (
            "stiffness: 2000",
            "stiffness: 2000, cutoff: 50",
            "7:79: cutoff: found a cutoff, which the backward damper does not have; expected damper: filtered",
        ),
        (
            "stiffness: 2000}",
            "stiffness: 2000}\n  m: {type: mass, mass: 1}\n"
            "  far: {type: viscoelastic, between: [m, wall], stiffness: 1, damper: sensed}",
            "9:71: damper: found sensed between 'm' and 'wall', which no device senses; expected a point of type "
            "device at one end",
        ),
        ("wall:", "2nd:", f"6:3: '2nd': {NAME}"),
        ("wall:", '"a\\n":', f"6:3: 'a\\n': {NAME}"),
        ("wall:", "true:", "6:3: found true (a boolean) as a key, expected a name"),
    ],
)
def test_what_is_no_module_is_reported(faults: Faults, good: str, old: str, new: str, told: str) -> None:
    # What concerns the name `wall` leaves the link to it dangling: a fault of its own, further down.
    text = good.replace(old, new)
    assert faults(text)[0] == told
    assert all("'wall', expected the name of a module" in follower for follower in faults(text)[1:])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "rate: 1000",
            "rte: 1000",
            "2:1: rte: unknown key, expected version, rate, substeps, devices, device, mock, mocks, leader, at, space, "
            "precision, scheme, modules, sound, inputs or outputs; did you mean 'rate'?",
        ),
        ("rate: 1000\n", "", f"1:1: 'rate' is missing, {HZ}"),
        (
            "rate: 1000",
            "rate: 1000\nrate: 500",
            "3:1: found the key 'rate' again, expected it once: it stands in line 2",
        ),
        ("rate: 1000", "rate: 1000\n? [a]\n: 4", "3:3: found a list as a key, expected a name"),
        (
            "channel: 0",
            "channel: 0, channel: 1",
            "5:37: found the key 'channel' again, expected it once: it stands in line 5",
        ),
    ],
)
def test_a_wrong_key_is_reported(only_fault: OnlyFault, old: str, new: str, told: str) -> None:
    assert only_fault(old, new) == told


def emptied(part: type[BaseModel], at: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """The paths of the optional keys of a part."""
    for name, field in part.model_fields.items():
        if not field.is_required() and name != "type" and (*at, name) not in REQUIRED_IN_A_MODE:
            yield (*at, name)


REQUIRED_IN_A_MODE = [("device",), *(("device", key) for key in ("mass", "simulated_mass", "assumed_hand"))]


OPTIONAL = [
    *emptied(Scene, ()),
    *emptied(Device, ("device",)),
    *emptied(Mock, ("mock",)),
    *emptied(Initial, ("mock", "initial")),
    *emptied(Hand, ("mock", "hand")),
    *(path for kind, part in MODULE_TYPES.items() for path in emptied(part, ("modules", kind))),
]


@pytest.mark.parametrize("written", ["", "~", "null"])
def test_an_empty_optional_key_is_not_taken_for_its_default(faults: Faults, written: str) -> None:
    # An emptied limit that meant the default would be a limit that the scene does not contain.
    assert {("device", "slew_limit"), ("device", "soft_start"), ("device", "energy_limit")} < set(OPTIONAL)
    for path in OPTIONAL:
        lines = [f"{'  ' * depth}{step}:" for depth, step in enumerate(path)]
        if path[0] == "modules":
            lines.insert(-1, f"    type: {path[1]}")
        found = f": {path[-1]}: found {written} (nothing), expected " if written else f": {path[-1]}: found nothing, "
        (told,) = [line for line in faults("\n".join(lines) + f" {written}\n") if found in line]
        assert told.endswith("; omit the key for the default")


def test_nothing_under_a_key_that_has_to_be_there_is_not_to_be_left_out(only_fault: OnlyFault) -> None:
    assert only_fault("stiffness: 2000", "stiffness: ") == (
        "7:64: stiffness: found nothing, expected a number >= 0 (N/m)"
    )
    assert only_fault("hand:  {type: device, channel: 0}", "hand:  {type: device, channel: 0}\n  more:") == (
        "6:8: more: found nothing, expected a mapping such as {type: mass, mass: 0.01}"
    )


@pytest.mark.parametrize("version", ["2", "0", "-1", "1.0", "'1'", "true", "one"])
def test_another_version_is_reported_with_the_one_that_this_hapsim_reads(only_fault: OnlyFault, version: str) -> None:
    fault = only_fault("version: 1", f"version: {version}")
    assert fault.startswith("1:10: version: found ")
    assert ", expected 1: this hapsim reads version 1 of the scene format" in fault


def test_of_another_version_nothing_else_is_reported(faults: Faults) -> None:
    (fault,) = faults("version: 2\nfrequency: 1000\n")
    assert fault == "1:10: version: found 2, expected 1: this hapsim reads version 1 of the scene format"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "1:1: found nothing, expected a scene; `hapsim new` writes a first one"),
        ("# a comment\n", "1:1: found nothing, expected a scene; `hapsim new` writes a first one"),
        ("---\n", "1:1: found nothing, expected a scene; `hapsim new` writes a first one"),
        ("hello", "1:1: found 'hello' (text), expected a mapping with version, rate, device and modules"),
        ("\n- 1\n", "2:1: found a list, expected a mapping with version, rate, device and modules"),
        ("42", "1:1: found 42, expected a mapping with version, rate, device and modules"),
    ],
)
def test_what_is_no_mapping_is_no_scene(faults: Faults, text: str, told: str) -> None:
    assert faults(text) == [told]


def test_modules_have_to_be_a_mapping(faults: Faults, good: str) -> None:
    text = good[: good.index("  hand")]
    expected = "expected a mapping from names to modules"
    assert faults(text) == [f"4:9: modules: found nothing, {expected}"]
    assert faults(text.replace("modules:", "modules: [a]")) == [f"4:10: modules: found a list, {expected}"]
    assert faults(text.replace("modules:\n", "")) == [f"1:1: 'modules' is missing, {expected}"]


def test_what_is_missing_is_reported_in_the_order_in_which_it_is_written(faults: Faults) -> None:
    assert [fault.split(" is ")[0] for fault in faults("# a scene\n\nmock: {}\n")] == [
        "3:1: 'version'",
        "3:1: 'rate'",
        "3:1: 'device'",
        "3:1: 'modules'",
    ]


def test_a_name_of_pydantic_in_the_file_is_a_name_like_any_other(faults: Faults, good: str) -> None:
    assert faults(good + "  '[key]': 3\n") == [
        f"8:3: '[key]': {NAME}",
        "8:12: '[key]': found 3, expected a mapping such as {type: mass, mass: 0.01}",
    ]
    assert faults(good.replace("ground}", "ground, ground: 1, '[key]': 1}")) == [
        "6:25: ground: unknown key, expected type or position",
        "6:36: '[key]': unknown key, expected type or position",
    ]


def test_all_errors_are_reported_at_once_in_the_order_of_the_file(faults: Faults) -> None:
    text = """\
modules:
  touch: {type: viscoelastic, between: [hand, wal], stifness: 2000, damping: -2}
  hand:  {type: device, channel: 0}
  wall:  {type: ground, position: "0"}
  m1:    {type: mass, mass: 2 N}
device:
  mass: [0.2, 0.2]
  hold: level
  hold: zoh
rate: .inf
mock: {initial: {position: x}, quantum: -1}
"""
    places = [fault.split(": ")[0] + ": " + fault.split(": ")[1] for fault in faults(text)]
    assert places == [
        "1:1: 'version' is missing, expected 1",
        "2:47: between[1]",
        "2:53: stifness",
        "2:78: damping",
        "4:35: position",
        "5:29: mass",
        "7:9: mass",
        "8:9: hold",
        "9:3: found the key 'hold' again, expected it once",
        "10:7: rate",
        "11:28: position",
        "11:41: quantum",
    ]


def test_what_is_no_scheme_is_reported(only_fault: OnlyFault) -> None:
    told = f"found 'midpont' (text), expected {one_of(get_args(SchemeName))}; did you mean 'midpoint'?"
    assert only_fault("rate: 1000", "scheme: midpont\nrate: 1000") == f"2:9: scheme: {told}"
