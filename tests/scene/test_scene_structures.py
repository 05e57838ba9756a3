"""Strings and membranes in a scene: what they take, what a link may hold of them, and what they consist of."""

from collections import Counter
from collections.abc import Callable

import pytest

from hapsim.scene import Membrane, Pluck, String, Structure, parse_scene

Faults = Callable[[str], list[str]]

STRING = "type: string, masses: 5, mass: 0.001, stiffness: 1000"
SKIN = "type: membrane, rows: 5, columns: 6, mass: 0.001, stiffness: 1000"
KEYS_OF_A_MEMBRANE = (
    "expected type, mass, stiffness, damping, friction, position, rows, columns or edges; did you mean 'edges'?"
)
OF_STRING = "but 's' is a string; expected one of its masses, 0 to 4, such as s.0"
OF_SKIN = (
    "but 'skin' is a membrane; expected one of its masses, its row (0 to 4), a dot and its column (0 to 5), such as "
    "skin.0.0"
)


def text_with(good: str, string: str = STRING, skin: str = SKIN, end: str = "s.1") -> str:
    return (
        f"{good}  s: {{{string}}}\n  skin: {{{skin}}}\n"
        f"  pull: {{type: viscoelastic, between: [hand, {end}], stiffness: 1}}\n"
    )


@pytest.mark.parametrize("end", ["s.0", "s.4", "skin.0.0", "skin.3.4", "skin.4.5"])
def test_a_link_may_hold_any_mass_of_a_structure(good: str, end: str) -> None:
    assert parse_scene(text_with(good, end=end)).links["pull"].between == ("hand", end)


@pytest.mark.parametrize(
    ("end", "told"),
    [
        ("s", OF_STRING),
        ("s.5", OF_STRING),
        ("s.-1", OF_STRING),
        ("s.", OF_STRING),
        ("s.٣", OF_STRING),
        ("s." + "9" * 50, OF_STRING),
        ("skin", OF_SKIN),
        ("skin.3", OF_SKIN),
        ("skin.3.", OF_SKIN),
        ("skin.5.0", OF_SKIN),
        ("skin.0.6", OF_SKIN),
        ("skin.1.2.3", OF_SKIN),
        ("skin.a.b", OF_SKIN),
    ],
)
def test_a_place_that_a_structure_does_not_have_is_reported(faults: Faults, good: str, end: str, told: str) -> None:
    assert faults(text_with(good, end=end)) == [f"10:46: between[1]: found '{end}', {told}"]


def test_a_place_of_thousands_of_digits_is_a_fault_like_any_other(faults: Faults, good: str) -> None:
    (told,) = faults(text_with(good, end="s." + "9" * 9000))
    assert told.endswith(OF_STRING)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("rows: 5", "rows: 1", "rows: found 1, expected a whole number from 2 to 300"),
        ("columns: 6", "columns: 2.0", "columns: found 2.0, expected a whole number from 2 to 300"),
        (", columns: 6", "", "skin: 'columns' is missing, expected a whole number from 2 to 300"),
        (
            "columns: 6",
            "columns: 6, edges: fixed",
            "edges: found 'fixed' (text), expected a list of 4 words, each fixed or free",
        ),
        (
            "columns: 6",
            "columns: 6, edges: [fixed, free]",
            "edges: found a list of 2, expected a list of 4 words, each fixed or free",
        ),
        (
            "columns: 6",
            "columns: 6, edges: [fixed, free, clamped, free]",
            "edges[2]: found 'clamped' (text), expected fixed or free",
        ),
        ("columns: 6", "columns: 6, edgs: [free]", f"edgs: unknown key, {KEYS_OF_A_MEMBRANE}"),
    ],
)
def test_what_is_no_membrane_is_reported(faults: Faults, good: str, old: str, new: str, told: str) -> None:
    (fault,) = faults(text_with(good, skin=SKIN.replace(old, new)))
    assert fault.split(": ", 1)[1] == told
    assert fault.startswith("9:")


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ("pluck: {at: 2}", "8:62: pluck: 'by' is missing, expected a number (m)"),
        ("pluck: {at: 2.5, by: 1}", "8:74: at: found 2.5, expected a whole number from 0 to 99999"),
        ("pluck: {at: 5, by: 0.1}", "8:74: at: found 5, but s has 5 masses; expected 0 to 4"),
        ("pluck: {at: 2, by: far}", "8:81: by: found 'far' (text), expected a number (m)"),
        ("pluck: {at: 2, bye: 1}", "8:77: bye: unknown key, expected at or by; did you mean 'by'?"),
        ("ends: [fixed, loose]", "8:76: ends[1]: found 'loose' (text), expected fixed or clamped or free"),
    ],
)
def test_what_is_no_string_is_reported(faults: Faults, good: str, more: str, told: str) -> None:
    (fault,) = faults(text_with(good, string=f"{STRING}, {more}"))
    assert fault == told


def test_a_fault_elsewhere_in_a_structure_does_not_hide_a_place_that_it_does_not_have(
    faults: Faults, good: str
) -> None:
    text = text_with(good, f"{STRING}, pluck: 1, damping: -1", end="s.7")
    assert [fault.split(": ")[1] for fault in faults(text)] == ["pluck", "damping", "between[1]"]


@pytest.mark.parametrize(
    ("old", "new", "end"),
    [("masses: 5", "masses: many", "s.x"), ("masses: 5, ", "", "s.0"), ("rows: 5", "rows: 0", "skin.9.6")],
)
def test_a_place_in_a_structure_whose_size_is_faulty_is_not_judged(
    faults: Faults, good: str, old: str, new: str, end: str
) -> None:
    (fault,) = faults(text_with(good, end=end).replace(old, new))
    assert "between" not in fault


@pytest.mark.parametrize(
    ("old", "new"),
    [("stiffness: 1}", "stiffness: -1}"), ("stiffness: 1}", "stiffness: 1, damper: none}"), ("stiffness: 1}", "}")],
)
def test_a_fault_elsewhere_in_a_link_does_not_hide_that_its_ends_are_none(
    faults: Faults, good: str, old: str, new: str
) -> None:
    (_, end) = sorted(faults(text_with(good, end="s.5").replace(old, new)), key=lambda fault: "between" in fault)
    assert end.endswith(f"found 's.5', {OF_STRING}")


def test_a_fault_elsewhere_in_a_string_does_not_hide_where_it_is_plucked(faults: Faults, good: str) -> None:
    told = faults(text_with(good, f"{STRING.replace('mass: ', 'mass: -')}, pluck: {{at: 5, by: 0.1}}"))
    assert [fault.split(": ")[1] for fault in told] == ["mass", "at"]


def test_a_string_that_is_plucked_states_where_its_masses_begin(good: str) -> None:
    text = text_with(good, f"{STRING}, position: 1, pluck: {{at: 1, by: 0.5}}")
    scene = parse_scene(text)
    string = scene.modules["s"]
    assert isinstance(string, String)
    assert string.pluck == Pluck(at=1, by=0.5)
    assert string.initial_positions() == pytest.approx([1.25, 1.5, 1.375, 1.25, 1.125])
    assert type(scene).model_validate(scene.model_dump()) == scene


def ends_of(structure: Structure) -> Counter[tuple[int, int]]:
    return Counter((a, b) for a, b, _, _ in structure.elements().links)


def test_a_membrane_is_its_masses_and_a_link_between_any_two_neighbours(good: str) -> None:
    skin = parse_scene(text_with(good)).modules["skin"]
    assert isinstance(skin, Membrane)
    assert skin.point_names()[7] == "1.1"
    assert skin.initial_positions() == [0.0] * 30
    links = ends_of(skin)
    inner = {pair: count for pair, count in links.items() if pair[1] != -1}
    assert len(inner) == 5 * 5 + 4 * 6
    assert set(inner.values()) == {1}
    assert all(b - a in (1, 6) for a, b in inner)
    held = {a: count for (a, b), count in links.items() if b == -1}
    assert sum(held.values()) == 2 * (5 + 6)
    assert [held[corner] for corner in (0, 5, 24, 29)] == [2] * 4


@pytest.mark.parametrize(
    ("edge", "held"),
    [(0, range(6)), (1, range(24, 30)), (2, range(0, 30, 6)), (3, range(5, 30, 6))],
    ids=["top", "bottom", "left", "right"],
)
def test_the_edges_of_a_membrane_are_the_top_the_bottom_the_left_and_the_right(
    good: str, edge: int, held: range
) -> None:
    words = ", ".join("fixed" if i == edge else "free" for i in range(4))
    skin = parse_scene(text_with(good, skin=f"{SKIN}, edges: [{words}]")).modules["skin"]
    assert isinstance(skin, Membrane)
    assert sorted(a for (a, b) in ends_of(skin) if b == -1) == list(held)
