"""The YAML that hapsim reads: its numbers, anchors and merge keys, and what is not YAML."""

from collections.abc import Callable

import pytest

from hapsim.scene import parse_scene

Faults = Callable[[str], list[str]]


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("1e-9", 1e-9),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("1.0e-9", 1e-9),
        ("!!float 7", 7.0),
    ],
)
def test_a_number_means_what_it_looks_like(good: str, written: str, meant: float) -> None:
    scene = parse_scene(good.replace("rate: 1000", f"rate: {written}"))
    assert scene.rate == meant
    assert isinstance(scene.rate, float)


@pytest.mark.parametrize("name", ["on", "no", "y", "_", "m-1", "E3", "inf", "device"])
def test_a_name_that_yaml_1_1_would_take_for_something_else_is_a_name(good: str, name: str) -> None:
    scene = parse_scene(good.replace("wall", name))
    assert list(scene.grounds) == [name]


def test_an_anchor_stands_for_its_value(good: str) -> None:
    scene = parse_scene(good.replace("rate: 1000", "rate: &r 1000") + "mock: {initial: {position: *r}}\n")
    assert scene.mock_device.initial_position == (1000.0,)


def test_a_merge_key_brings_keys_that_the_mapping_does_not_have_itself(good: str) -> None:
    text = good.replace("touch: {", "touch: &spring {") + (
        "  m: {type: mass, mass: 1}\n"
        "  more: {<<: *spring, between: [m, hand]}\n"
        "  most: {damping: 3, <<: [{stiffness: 5}, *spring], between: [m, wall]}\n"
    )
    links = {name: (link.between, link.stiffness, link.damping) for name, link in parse_scene(text).links.items()}  # type: ignore[attr-defined]
    assert links["more"] == (("m", "hand"), 2000.0, 0.0)
    assert links["most"] == (("m", "wall"), 5.0, 3.0)


def test_a_fault_behind_an_anchor_is_reported_once_and_where_it_stands(faults: Faults, good: str) -> None:
    text = good.replace("touch: {", "touch: &spring {").replace("2000", "-1")
    text += "  m: {type: mass, mass: 1}\n  more: {<<: *spring, between: [m, hand]}\n"
    assert faults(text) == ["7:73: stiffness: found -1, expected a number >= 0 (N/m)"]


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        ("<<: 3", "8:5: <<: found 3, expected a mapping to take keys from"),
        ("<<: [3]", "8:6: <<: found 3, expected a mapping to take keys from"),
        ("mock: &m {<<: *m}", "8:7: found a mapping that contains itself, expected an end to it"),
        ("mock: &m {initial: {position: &p [*p]}}", "8:31: found a list that contains itself, expected an end to it"),
    ],
)
def test_a_reference_that_leads_nowhere_is_reported(faults: Faults, good: str, extra: str, told: str) -> None:
    assert faults(good + extra + "\n") == [told]


MAPPING_ADVICE = "is a line broken or indented too far, or are quotes missing?"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("rate:\n\tx: 1\n", "2:1: found a tab, expected spaces: YAML is indented with spaces only"),
        (
            "rate: 1 device: 2\n",
            "1:15: not YAML: mapping values are not allowed here; " + MAPPING_ADVICE,
        ),
        (
            "rate: [1,\n",
            "2:1: not YAML: expected the node content, but found '<stream end>' "
            "(while parsing a flow node, which began in line 2); is a bracket or a quote left open?",
        ),
        ("rate: [1, 2\n", "1:7: found [ without its ]; add it"),
        ("rate: 'x\n", "1:7: found ' without its '; add it"),
        ("a: {b: [1, 2}\n", "1:8: found [ without its ]; add it before the } in column 13"),
        ("a: {b: 1\nc: 2\n", "1:4: found { without its }; add it before line 2, or a comma in front of that line"),
        ("a:\n  - b: 1\n  c: 2\n", "2:3: found '- b: 1' in a column of keys, expected a key; remove the '-'"),
        ("a:\n  b: 1\n  - c: 2\n", "3:3: found '- c: 2' in a column of keys, expected a key; remove the '-'"),
        ("a:\n  b:\n  - 1\n  c: d: 2\n", "4:7: not YAML: mapping values are not allowed here; " + MAPPING_ADVICE),
        (
            "rate: @x\n",
            "1:7: not YAML: found character '@' that cannot start any token "
            "(while scanning for the next token); put the text in quotes",
        ),
        ("rate: *x\n", "1:7: not YAML: found undefined alias 'x'"),
        ("a: &x 1\nb: &x 2\n", "2:4: found the same anchor (&name) a second time, expected each anchor once"),
        ("rate: 1\n---\nrate: 2\n", "2:1: found a second document, expected one scene in a file"),
        ("rate: 'a\x07'\n", "1:9: found the character U+0007, expected printable text"),
        ("a: 1\nb: \ud800\n", "2:4: found the character U+D800, expected printable text"),
        ('rate: "\\UFFFFFFFF"\n', "1:10: not YAML: found an escape such as \\U… that names no character"),
    ],
)
def test_what_is_not_yaml_is_reported_where_it_breaks(faults: Faults, text: str, told: str) -> None:
    assert faults(text) == [told]


UNSPACED = """\
# a scene: from elsewhere
version:1
rate:1000
device:
  mass: 0.2
modules:
  hand:{type: device, channel: 0}
"""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (UNSPACED, "2:9: found 'version:1'; put a space after the colon: 'version: 1'"),
        (
            "version: 1\nrate:1000 # Hz\ndevice: {mass: 1}\n",
            "2:6: found 'rate:1000'; put a space after the colon: 'rate: 1000'",
        ),
        (
            "device:\n  port:/dev/ttyACM0\n  mass: 1\n",
            "2:8: found 'port:/dev/ttyACM0'; put a space after the colon: 'port: /dev/ttyACM0'",
        ),
    ],
)
def test_of_colons_without_a_space_the_first_is_reported(faults: Faults, text: str, told: str) -> None:
    assert faults(text) == [told]


def test_a_colon_without_a_space_is_not_blamed_for_something_else(faults: Faults) -> None:
    assert faults("version:1\nrate: [1\n") == [
        "2:5: not YAML: mapping values are not allowed here; "
        "is a line broken or indented too far, or are quotes missing?"
    ]
    (told,) = faults("http://somewhere\n")
    assert told.startswith("1:1: found 'http://somewhere' (text), expected a mapping with version")


def test_a_colon_without_a_space_within_a_scene_is_reported_with_what_to_do(faults: Faults, good: str) -> None:
    remedy = "; put a space after the colon: 'mass: 0.2'"
    assert faults(good.replace("{mass: 0.2}", "\n  mass:0.2")) == [
        f"4:3: device: found 'mass:0.2' (text), expected a mapping{remedy}"
    ]
    (told,) = faults(good.replace("mass: 0.2", "mass:0.2"))
    assert told.startswith("3:10: 'mass:0.2': unknown key, expected port, ")
    assert told.endswith(remedy)


POINT = "a decimal point: "
AS_LIST = "a comma separates entries, and a decimal has a point: "


@pytest.mark.parametrize(
    ("written", "remedy"),
    [
        ("0,2", f"{POINT}0.2"),
        ("-1000,5", f"{POINT}-1000.5"),
        ("7,5 deg", f"{POINT}7.5 deg"),
        ("2,000", f"2000, or {POINT}2.000"),
        ("1,000,000", "1000000"),
        ("2,500.5", "2500.5"),
        ("-1,5e3µN", f"{POINT}-1.5e3µN"),
    ],
)
def test_a_comma_in_a_number_is_reported_with_the_number_to_write(faults: Faults, written: str, remedy: str) -> None:
    text = f"rate: {written}\nmock:\n  mass: {written}\nmodules:\n  m:\n    type: mass\n    mass: {written}\n"
    told = [line.partition(": ") for line in faults(text) if "(text)" in line]
    assert [place for place, _, _ in told] == ["1:7", "3:9", "7:11"]
    for _, _, sentence in told:
        assert f": found '{written}' (text), expected a number > 0 (" in sentence
        assert sentence.endswith(f"; write {remedy}")


@pytest.mark.parametrize(
    ("written", "remedy"),
    [
        ("2,000", f"2000, or {POINT}2.000"),
        ("1,000,000", "1000000"),
        ("0,5", f"{POINT}0.5"),
        ("7,5 deg", f"{POINT}7.5 deg"),
        ("2,500.5", "2500.5"),
        ("0,2kN/m", f"{POINT}0.2kN/m"),
    ],
)
def test_a_comma_in_a_number_in_braces_is_reported_once(faults: Faults, good: str, written: str, remedy: str) -> None:
    told = [f"7:65: found '{written}', expected a number without a comma; write {remedy}"]
    assert faults(good.replace("2000", written)) == told
    assert faults(good.replace("2000}", f"{written}, damping: 2}}")) == told


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.2", "0.2, travel: [-0,05, 0,05]", f"[the least, the most] (m); {AS_LIST}[-0.05, 0.05]"),
        ("0.2", "0.2, travel: [-0,05]", f"a number (m); {AS_LIST}[-0.05]"),
        ("0.2", "[0,2]", f"a number > 0 (kg); {AS_LIST}[0.2]"),
        ("1000", "[1000,5]", f"a number > 0 (Hz); {AS_LIST}[1000.5]"),
        (
            "viscoelastic, between: [hand, wall], stiffness: 2000}",
            "nonlinear, between: [hand, wall], force_over_distance: [[0, 0], [0,05, 1]]}",
            f"a point [m, N], two numbers; {AS_LIST}[0.05, 1]",
        ),
    ],
)
def test_a_comma_in_a_number_of_a_list_is_reported_with_the_list_to_write(
    only_fault: Callable[[str, str], str], old: str, new: str, told: str
) -> None:
    assert only_fault(old, new).split(", expected ")[1].split(", or ")[0] == told


@pytest.mark.parametrize(
    ("written", "entries"), [("1,2,3", "1, 2, 3"), ("0.2,3", "0.2, 3"), ("-1,2,-3,4", "-1, 2, -3, 4")]
)
def test_several_numbers_without_brackets_are_reported_with_the_list(
    faults: Faults, good: str, written: str, entries: str
) -> None:
    remedy = f"; a decimal has a point, and a list has brackets: [{entries}]"
    (fault,) = faults(good.replace("mass: 0.2", f"mass: '{written}'"))
    assert fault.endswith(remedy)


def test_several_numbers_in_braces_are_reported_with_the_list(faults: Faults, good: str) -> None:
    remedy = "expected a number without a comma; a decimal has a point, and a list has brackets: [1, 2, 3]"
    assert faults(good.replace("2000", "1,2,3")) == [f"7:65: found '1,2,3', {remedy}"]


@pytest.mark.parametrize(
    ("written", "remedy"),
    [
        ("[1,2,3]", "; a comma separates entries, and a decimal has a point"),
        ("[0,2 kN/m]", "; a comma separates entries, and a decimal has a point: [0.2 kN/m]"),
    ],
)
def test_a_number_is_suggested_for_a_list_unless_it_may_mean_several(
    only_fault: Callable[[str, str], str], written: str, remedy: str
) -> None:
    assert only_fault("2000", written).endswith(f"expected a number >= 0 (N/m){remedy}")


def test_a_comma_in_an_item_on_its_own_line_is_reported_there(only_fault: Callable[[str, str], str]) -> None:
    told = only_fault("{mass: 0.2}", "\n  mass: 0.2\n  travel:\n  - -0.05\n  - 0,05")
    assert told == f"7:5: travel[1]: found '0,05' (text), expected a number (m); write {POINT}0.05"


def test_a_list_that_is_wrong_for_another_reason_is_not_blamed_on_commas(only_fault: Callable[[str, str], str]) -> None:
    assert only_fault("0.2", "0.2, travel: [1, 2, 3]").endswith("expected [the least, the most] (m)")
    assert only_fault("0.2", "[0, 2]").endswith("mass[0]: found 0, expected a number > 0 (kg)")


DEVICE = "version: 1\nrate: 1000\ndevice:\n  delay: 1\n  mass: 0.2\n  travel:\n    - -0.05\n    - 0.05\nmock: {}\n"
KEYS, ITEMS = "the keys of a mapping must be indented alike", "the items of a list must be indented alike"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("  mass", "   mass", f"5:4: found 'mass: 0.2' in column 4, expected column 3 as in line 4: {KEYS}"),
        ("  mass", "mass", f"6:3: found 'travel:' in column 3, expected column 1 as in line 5: {KEYS}"),
        (
            "  mass",
            " mass",
            f"5:2: found 'mass: 0.2' in column 2, expected column 3 as in line 4 or column 1 as in line 3: {KEYS}",
        ),
        ("  delay", "    delay", "5:3: found 'mass: 0.2' in column 3, expected column 5 as in line 4 or column 1"),
        ("rate", " rate", f"2:2: found 'rate: 1000' in column 2, expected column 1 as in line 1: {KEYS}"),
        ("mock", " mock", "9:2: found 'mock: {}' in column 2, expected column 3 as in line 6 or column 1 as in line 3"),
        (
            "delay: 1\n  mass",
            "mass: {from: 1,\n      to: 2}\n   delay",
            f"6:4: found 'delay: 0.2' in column 4, expected column 3 as in line 4: {KEYS}",
        ),
        ("    - 0.05", "   - 0.05", f"8:4: found '- 0.05' in column 4, expected column 5 as in line 7: {ITEMS}"),
        ("    - 0.05", "     - 0.05", f"7:5: travel: found a list of 1, expected [the least, the most] (m); {ITEMS}"),
        ("  mass", "\tmass", "5:1: found a tab, expected spaces: YAML is indented with spaces only"),
        ("{}", "'a' b", "9:11: not YAML: expected <block end>, but found '<scalar>' (while parsing a block mapping, "),
    ],
)
def test_a_wrong_indentation_is_reported_with_the_column_to_begin_in(
    faults: Faults, old: str, new: str, told: str
) -> None:
    assert DEVICE.count(old) == 1
    assert any(line.startswith(told) for line in faults(DEVICE.replace(old, new))), faults(DEVICE.replace(old, new))


def test_a_number_behind_a_comma_and_a_space_is_a_key(faults: Faults, good: str) -> None:
    assert faults(good.replace("2000", "2, 000"))[0].startswith("7:68: '000': unknown key, expected type, ")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("[" * 100_000, "1:34"),
        ("- " * 100_000, "1:67"),
        ("{a: " * 10_000, "1:130"),
        ("\n".join(" " * depth + "a:" for depth in range(3000)), "33:33"),
    ],
)
def test_very_deep_nesting_is_reported_and_not_read(faults: Faults, text: str, place: str) -> None:
    assert faults(text) == [f"{place}: found more than 32 levels, one within the other; expected at most five"]


def test_nesting_through_anchors_is_not_read_either(faults: Faults) -> None:
    chain = ["a0: &a0 {x: 1}", *(f"a{i}: &a{i} {{<<: *a{i - 1}}}" for i in range(1, 1500)), "<<: *a1499"]
    assert any("found more than 32 levels" in fault for fault in faults("\n".join(chain)))


def test_references_that_multiply_are_not_written_out(faults: Faults) -> None:
    laughs = ["a0: &a0 [ha, ha]"]
    laughs += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 25)]
    text = "\n".join([*laughs, "rate: *a24", "modules: {a: *a24}"])
    assert "25:6: rate: found a list, expected a number > 0 (Hz)" in faults(text)
