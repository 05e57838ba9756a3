"""The drawn entries of a scene: every module once, in rows of numbers that give its position and what touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from live_clients import PLANE, SCENE, Block, Client

from hapsim.live import drawn
from hapsim.live.drawn import AnyEntry, LinkEntry, OutlineEntry, Picture, PointEntry, StructureEntry, drawn_of
from hapsim.running import start
from hapsim.scene import load_scene, parse_scene
from hapsim.scene.shipped import shipped_scenes

Serve = Callable[..., Any]
LINE = (
    SCENE.replace("clock: host", "clock: lockstep").replace(
        "mock: {initial: {position: 0.0, velocity: 0.1}}", "mock: {}"
    )
    + """
  left: {type: device, channel: 1}
  floor: {type: ground, position: -0.01}
  bell: {type: cell, mass: 0.01, stiffness: 100, damping: 0.1, rest: 0.02}
  gut: {type: string, masses: 9, mass: 0.001, stiffness: 300, damping: 0.01, ends: [fixed, free]}
  skin: {type: membrane, rows: 3, columns: 4, mass: 0.001, stiffness: 150, damping: 0.01, position: 0.002}
  stop: {type: buffer, between: [hand, floor], stiffness: 500}
  pick: {type: plectrum, between: [left, gut.3], stiffness: 50, damping: 0.1, release: 0.001}
  felt: {type: buffer, between: [left, skin.1.2], stiffness: 10}
"""
)


def places_in(row: np.ndarray[Any, Any], entries: list[AnyEntry], space: int) -> dict[str, list[float]]:
    """Returns the numbers of each entry, by kind and name, as a client takes them from a row."""
    found, at = {}, 0
    for one in entries:
        count = 0
        if isinstance(one, PointEntry):
            count = space
        elif isinstance(one, StructureEntry):
            count = len(one.rows or [0]) * len(one.columns)
        elif isinstance(one, LinkEntry):
            count = int(one.is_contact)
        found[one.name if not isinstance(one, OutlineEntry) else f"outline {one.name}"] = row[at : at + count].tolist()
        at += count
    assert at == row.size
    return found


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_module_of_a_shipped_scene_is_drawn_once(name: str) -> None:
    scene = load_scene(name)
    entries = drawn_of(scene)
    assert sorted(one.name for one in entries if not isinstance(one, OutlineEntry)) == sorted(scene.modules)
    assert scene.space == 2 or not any(isinstance(one, OutlineEntry) for one in entries)


def row_where(hands: list[float], text: str = LINE) -> tuple[dict[str, list[float]], Mapping[str, Any]]:
    """Returns a row of a scene, and the state's positions, once the mock's hands rest about these places, m."""
    hold = f"{{hand: {{stiffness: 5000, damping: 50, position: {hands}}}}}"
    scene = parse_scene(text.replace("mock: {}", f"mock: {hold}"))
    with start(scene, keep=False, unstable=True) as session:
        next(state for state in session.subscribe(500.0) if state.sample > 4000)
        found = Picture().row(session)
        assert found is not None
        modules = session.state().modules
    return places_in(found[1], drawn_of(scene), scene.space), modules


def test_a_row_has_all_positions_on_a_line() -> None:
    row, modules = row_where([0.003, 0.0])
    assert {*row} == {*parse_scene(LINE).modules}
    for name, at in modules.items():
        assert row[name] == pytest.approx(np.ravel(at), abs=2e-5), name
    assert row["hand"][0] == pytest.approx(0.003, abs=2e-3)
    assert row["bell"] == pytest.approx([0.02])


@pytest.mark.parametrize(
    ("hands", "touching"),
    [([0.003, 0.0], {"felt", "pick"}), ([-0.02, 0.03], {"stop"}), ([0.0, -0.03], {"felt"})],
    ids=["gripped", "released above", "released below"],
)
def test_a_row_has_the_contacts_that_touch_on_a_line(hands: list[float], touching: set[str]) -> None:
    row, _ = row_where(hands)
    assert {name for name in ("stop", "pick", "felt") if row[name] == [1.0]} == touching
    assert row["touch"] == [], "a spring always acts"


@pytest.mark.parametrize(("hand", "touching"), [((0.012, 0.0), True), ((-0.02, -0.02), False)])
def test_a_row_has_the_surfaces_that_are_touched_in_the_plane(hand: tuple[float, float], touching: bool) -> None:
    row, modules = row_where([*hand], PLANE.replace("device: {", "mock: {}\ndevice: {clock: lockstep, "))
    assert row["disc"] == [float(touching)]
    assert row["hand"] == pytest.approx([modules["hand.x"], modules["hand.y"]], abs=2e-5)
    assert row["ball"] == pytest.approx([modules["ball.x"], modules["ball.y"]], abs=2e-5)
    assert row["post"] == pytest.approx([0.03, 0.0])
    assert row["outline disc"] == []


CURVES = {
    "buffer": "type: buffer, stiffness: 300, distance: 0.004",
    "click": "type: click, travel: 0.004, peak: 2, drop: 1, bottom: 5000",
    "curve": "type: nonlinear, force_over_distance: [[-0.004, 0], [-0.002, -1], [0.001, 0], [0.003, 0], [0.005, 2]]",
    "everywhere": "type: nonlinear, force_over_distance: [[-0.004, -1], [0.005, 2]]",
    "detent": "type: detent, shape: snap, pitch: 0.004, depth: 1, sharpness: 2",
}


@pytest.mark.parametrize("link", CURVES)
def test_a_contact_is_apart_just_where_its_law_has_no_force(link: str) -> None:
    law = parse_scene(SCENE + f"  edge: {{between: [hand, wall], {CURVES[link]}}}\n").links["edge"].table()
    assert law is not None
    free, d = law.without_force, np.random.default_rng(7).uniform(-0.01, 0.01, 2000)
    apart = np.any([(low <= d) & (d <= high) for low, high in free], axis=0) if free else np.zeros(d.size, bool)
    assert np.array_equal(apart, law.tension(d) == 0.0)
    assert bool(free) == (link not in ("everywhere", "detent"))


def test_of_large_structures_every_nth_mass_is_shown_and_each_that_a_link_holds() -> None:
    text = (
        SCENE
        + """
  gut: {type: string, masses: 5003, mass: 0.001, stiffness: 3}
  skin: {type: membrane, rows: 100, columns: 150, mass: 0.001, stiffness: 1}
  pick: {type: spring, between: [hand, gut.1234], stiffness: 1}
  felt: {type: spring, between: [hand, skin.33.77], stiffness: 1}
"""
    )
    gut, skin = (one for one in drawn_of(parse_scene(text)) if isinstance(one, StructureEntry))
    assert gut.rows is None
    assert {0, 1234, 5002} < {*gut.columns}
    assert drawn.MOST_IN_STRING / 2 < len(gut.columns) <= drawn.MOST_IN_STRING + 2
    assert skin.rows is not None
    assert {0, 33, 99} < {*skin.rows}
    assert {0, 77, 149} < {*skin.columns}
    assert max(len(skin.rows), len(skin.columns)) <= drawn.MOST_IN_ROW + 2
    assert np.all(np.diff(gut.columns) > 0)
    assert gut.masses()[-1] == "gut.5002"
    assert skin.masses()[len(skin.columns) - 1 :][:2] == ["skin.0.149", f"skin.{skin.rows[1]}.0"]


def test_a_client_gets_the_rows_that_it_asks_for(serve: Serve) -> None:
    served = serve(LINE)
    with served.client() as client:
        entries = drawn_of(served.session.scene)
        assert client.ask(type="get")["drawn"] == [one.model_dump(mode="json") for one in entries]
        client.ask(type="subscribe", rate=100)
        assert _kinds(client) == {1}
        client.ask(type="subscribe", rate=100, picture=True)
        first = client.block(kind=3)
        assert first.rows.shape[0] == 1
        assert any(client.block(kind=3).first > first.first for _ in range(200))
        assert places_in(first.rows[0, 1:], entries, 1)["wall"] == [0.0]
        served.hub.adopt(LINE.replace("masses: 9", "masses: 7"))
        width = first.rows.shape[1] - 2
        assert any(client.block(kind=3).rows.shape[1] == width for _ in range(200)), "of the scene that runs"


def _kinds(client: Client) -> set[int]:
    return {one.kind for one in (client.next() for _ in range(10)) if isinstance(one, Block)}
