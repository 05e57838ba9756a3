"""Inputs and outputs of a running scene, for other programs and on the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from live_clients import SOFT, Served, serving
from test_live_osc import Client, answering
from test_live_osc_query import Asked

STOP = "  stop: {type: buffer, between: [hand, wall], stiffness: 10, distance: -1}\n"
OUTPUTS = "{code: {bits: [8, 15]}, led: {bit: 3}, hit: {bit: 2, when: stop}}"
WORDS = SOFT.replace("modules:", f"inputs: {{touch: {{bit: 0}}}}\noutputs: {OUTPUTS}\nmodules:") + STOP
NAMES = ["inputs.touch", "outputs.code", "outputs.led", "outputs.hit"]


@pytest.fixture(scope="module")
def words() -> Iterator[Served]:
    with serving(WORDS) as served:
        yield served


def test_a_block_ends_with_them_in_the_order_of_the_model(words: Served) -> None:
    with words.client() as client:
        model = client.ask(type="get")
        assert model["words"] == NAMES
        by_name = {one["name"]: one for one in model["parameters"]}
        assert {name for name in by_name if "puts." in name} == {"outputs.code", "outputs.led", "mock.inputs.touch"}
        assert (by_name["outputs.code"]["most"], by_name["outputs.code"]["saved"]) == (255.0, None)
        assert client.ask(type="set", values={"outputs.code": 17, "mock.inputs.touch": 1})["type"] == "done"
        client.ask(type="subscribe", rate=100, every=1)
        rows = client.block().rows
        while tuple(rows[-1, 5:7]) != (1.0, 17.0):
            rows = client.block().rows
        assert rows.shape[1] == 2 + 3 + len(NAMES)
        refused = client.ask(type="set", values={"outputs.code": 300})
        assert refused["reason"] == "outputs.code: found 300, expected a whole number from 0 to 255"


def test_of_a_link_behind_a_gate_the_hand_feels_what_is_there_now(serve: Callable[..., Any]) -> None:
    served = serve(
        WORDS.replace("stiffness: 10,", "stiffness: 10, when: touch,").replace("distance: -1", "distance: 9")
    )
    with served.client() as client:
        for is_on, stiffness, words in ((0, 20.0, "touch is off"), (1, 30.0, "")):
            client.ask(type="set", values={"mock.inputs.touch": is_on})
            while served.session.progress().words["inputs.touch"] != is_on:
                pass
            answer = client.ask(type="predict", at=[0.0], curve=True)
            assert (answer["hands"][0]["K"], answer["inputs"]) == (stiffness, words)


def test_osc_sets_outputs_and_streams_inputs(words: Served) -> None:
    with answering(words.hub) as view:
        client = Client(view)
        client.send_message("/hapsim/outputs/code", 33)
        client.send_message("/hapsim/mock/inputs/touch", 1)
        assert client.ask("/hapsim/outputs/code") == [33.0]
        client.send_message("/hapsim/subscribe", client.port, 100)
        while client.receive("/hapsim/inputs/touch") != [1]:
            pass
        assert client.receive("/hapsim/outputs/hit")[0] in (0, 1)
        for _ in range(500):  # the loop takes it at its next tick
            client.receive("/hapsim/ticks")
            if words.session.state().progress.words["outputs.code"] == 33:
                break
        client.send_message("/hapsim/subscribe", client.port, 0)
    assert words.session.state().progress.words["outputs.code"] == 33


def test_osc_query_lists_what_can_be_set_and_what_can_be_read(words: Served) -> None:
    asked = Asked(words)
    try:
        status, tree = asked.get("/")
    finally:
        asked.server.close()
    assert status == 200
    found = tree["CONTENTS"]["hapsim"]["CONTENTS"]
    assert found["inputs"]["CONTENTS"]["touch"]["ACCESS"] == 1
    each = found["outputs"]["CONTENTS"]
    assert {name: one["ACCESS"] for name, one in each.items()} == {"code": 3, "led": 3, "hit": 1}
    assert each["code"]["RANGE"] == [{"MIN": 0.0, "MAX": 255.0}]


def test_the_page_shows_and_sets_them(browser: Any, serve: Callable[..., Any]) -> None:
    from live_page import Page

    page = Page(browser, serve(WORDS))
    field = "document.querySelector('#words input[data-name=\"{}\"]')"

    def shown() -> list[str]:
        return [str(one.text) for one in page.part("words").find_elements("tag name", "output")]

    def change(name: str, script: str) -> None:
        page.browser.execute_script(f"const one = {field.format(name)}; {script}; one.onchange()")

    assert [one.text for one in page.part("words").find_elements("tag name", "label")] == [
        "touch",
        "code",
        "led",
        "hit",
    ]
    assert page.browser.execute_script("return document.getElementById('set outputs.code')") is None  # no slider
    change("outputs.code", "one.value = 200")
    change("mock.inputs.touch", "one.checked = true")
    page.until(lambda: shown()[:2] == ["1", "200"])
    page.served.session.set({"outputs.led": 1})
    page.until(lambda: page.browser.execute_script(f"return {field.format('outputs.led')}.checked"))
    assert page.text("save") == "Save"  # they are no unsaved values
    change("outputs.code", "one.value = 300")
    page.until(lambda: "found 300" in page.text("words"))
    assert np.isclose(page.value("outputs.code"), 200.0)


def test_without_words_the_page_has_no_such_part(page: Any) -> None:
    assert not page.part("words-part").is_displayed()
