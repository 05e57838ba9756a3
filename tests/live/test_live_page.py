"""The page of a running scene in a real browser, headless: Debian's Chromium, driven by Selenium."""

from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from live_clients import CELL, DETENT, SCENE, SOFT
from live_page import Page, later, scope, selenium

from hapsim import predict
from hapsim.live import web
from hapsim.scene import load_scene


def test_it_loads_and_shows_what_is_felt_and_nothing_is_logged(page: Page) -> None:
    felt = predict(page.served.hub.scene).felt[0]
    assert page.text("felt").startswith(f"2000 N/m and 6 N·s/m feel like {felt.k:.4g} and {felt.b:.4g} ")
    assert "own 1 N·s/m included" in page.text("felt")
    assert "stable" in page.text("felt")
    assert page.part("set touch.stiffness").is_displayed()
    page.until(lambda: "Hz" in page.text("status"))
    assert page.browser.get_log("browser") == []


def test_what_is_felt_is_predicted_while_a_slider_moves_and_applied_when_it_is_let_go(page: Page) -> None:
    before = page.text("felt")
    page.slide("touch.stiffness", 0.55, "input")
    page.until(lambda: "not applied yet" in page.text("felt"))
    assert page.value("touch.stiffness") == 2000.0
    page.slide("touch.stiffness", 0.55, "change")
    page.until(lambda: "not applied yet" not in page.text("felt") and page.text("felt") != before)
    changed = page.value("touch.stiffness")
    assert changed > 2000.0
    assert page.text("felt").startswith(f"{changed:.4g}")


def rests_at(page: Page, position: float) -> bool:
    """Returns whether the hand is there and slow: at the end of a swing it is slow somewhere else."""
    state = page.served.session.state()
    return abs(state.position[0] - position) < 0.02 * abs(position) and abs(state.velocity[0]) < 1e-3


def pulls_as(page: Page, stiffness: float) -> bool:
    """Returns whether the newest force is that of SOFT with this stiffness, and another one would have another: at any
    place but the middle, so that a busy machine need not bring the hand to rest."""
    state = page.served.session.state()
    spring = stiffness * state.position[0]
    return abs(spring) > 0.005 and abs(state.force[0] + spring + 5.0 * state.velocity[0]) < 0.1 * abs(spring)


def test_a_slider_changes_the_force(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(SOFT))
    page.served.session.set({"mock.hand": {"force": 0.02}})  # a steady push
    page.until(lambda: pulls_as(page, 20.0))
    page.slide("touch.stiffness", 0.2, "change")
    page.until(lambda: page.value("touch.stiffness") < 10.0)
    page.until(lambda: pulls_as(page, page.value("touch.stiffness")))


def test_a_reload_keeps_the_last_minute(page: Page) -> None:
    page.until(lambda: page.served.session.state().sample > 500)
    before = page.served.session.state().sample
    page.browser.refresh()
    page.until(lambda: "feel like" in page.text("felt") and scope(page, "samples.count") > 0)
    shown, last = scope(page, "[samples.count, samples.last]")
    assert last - shown < before - 200, "what came before the page was opened, too"


def choose(page: Page, id: str, value: str) -> None:
    script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event(arguments[2]))"
    page.browser.execute_script(script, page.part(id), value, "input" if id == "level" else "change")


def test_a_single_shot_freezes_where_the_level_is_crossed(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(SOFT))
    session = page.served.session
    session.set({"mock.hand": {"stiffness": 500.0, "damping": 20.0, "position": -0.004}})
    page.until(lambda: rests_at(page, -0.004 * 500.0 / 520.0))
    settled = session.state().sample
    page.until(lambda: scope(page, "samples.last") > settled)  # the page may be behind: it has swings yet to come
    choose(page, "span", "0.2")
    choose(page, "trigger", "single")
    choose(page, "level", "0")
    assert page.part("freeze").get_attribute("aria-pressed") == "false"
    session.set({"mock.hand": {"position": 0.004}})
    page.until(lambda: page.part("freeze").get_attribute("aria-pressed") == "true")
    at = "Math.round(scope.frozenAt - 0.8 * scope.spanS / samples.period)"
    beside = f"[-3, 3].map((way) => samples.columns[0][({at} + way) % samples.size])"
    before, after = scope(page, beside)
    assert before < 0.0 < after, "a fifth of the picture is before the crossing"
    page.part("freeze").click()
    assert page.part("freeze").get_attribute("aria-pressed") == "false", "and waits for the next one"


def test_the_wheel_zooms_and_dragging_looks_back(page: Page) -> None:
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    page.until(lambda: scope(page, "samples.count") > 700)
    origin = ScrollOrigin.from_element(page.part("scope"))
    selenium.ActionChains(page.browser).scroll_from_origin(origin, 0, -500).perform()
    page.until(lambda: scope(page, "scope.spanS") < 1.0)
    on_scope = selenium.ActionChains(page.browser).move_to_element(page.part("scope"))
    on_scope.click_and_hold().move_by_offset(120, 0).release().perform()
    page.until(lambda: scope(page, "scope.isFrozen && scope.frozenAt < samples.count - 100"))
    selenium.ActionChains(page.browser).double_click(page.part("scope")).perform()
    page.until(lambda: scope(page, "[scope.spanS, scope.isFrozen]") == [2, False])


def test_a_module_is_watched_row_by_row(page: Page) -> None:
    choose(page, "what", "module wall")
    page.until(lambda: scope(page, "samples.rows") > 100)
    page.served.session.set({"wall": {"position": 0.0015}})
    newest = "samples.places[(samples.rows - 1) % samples.places.length]"
    page.until(lambda: scope(page, newest) == pytest.approx(0.0015))
    steps = "{length: Math.min(samples.rows, samples.at.length) - 1}, (_, i) => samples.at[i + 1] - samples.at[i]"
    assert not scope(page, f"Array.from({steps}).filter((one) => one < 0)")


def test_the_scope_shows_what_the_device_senses(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(SCENE.replace("device: {", "device: {sensors: [acceleration], ")))
    offered = page.browser.execute_script("return [...document.getElementById('what').options].map((one) => one.text)")
    assert offered[:4] == ["position", "velocity", "force", "sensed acceleration"]
    choose(page, "what", "3 0")
    page.until(lambda: scope(page, "samples.count") > 100)
    assert scope(page, "scope.unit") == "m/s²"
    assert scope(page, "Math.max(...samples.columns[3].map(Math.abs))") > 1.0


def test_how_steady_it_runs_is_drawn(page: Page) -> None:
    drawn = "[...arguments[0].getContext('2d').getImageData(0, 30, arguments[0].width, 40).data].some((one) => one > 0)"
    for id in ("exchange", "lateness"):
        page.until(lambda id=id: page.browser.execute_script(f"return {drawn}", page.part(id)))


def test_each_hand_has_its_plane(browser: Any, serve: Callable[..., Any]) -> None:
    right = "right: {type: device, channel: 1}"
    other = "other: {type: viscoelastic, between: [right, wall], stiffness: 800, damping: 3}"
    page = Page(browser, serve(f"{SCENE}  {right}\n  {other}\n"))
    assert page.text("felt").startswith("2000 ")
    choose(page, "hand", "right")
    page.until(lambda: page.text("felt").startswith("800 "))


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("is_away", [False, True])
def test_the_stop_button_ends_the_run(page: Page, is_away: bool) -> None:
    if is_away:
        page.served.pause()
    with page.served.ending():
        page.part("stop").click()


def test_a_run_that_the_machine_held_up_has_a_button_to_go_on(page: Page) -> None:
    button, asked = page.part("go-on"), threading.Event()
    assert not button.is_displayed()
    page.served.pause()
    page.served.hub.observer.paused(asked.set)
    page.served.hub.observer.report("paused", "held up")
    page.until(button.is_displayed)
    page.until(lambda: page.text("status") == "paused: this machine was too slow")
    page.browser.refresh()  # and who comes later has it too
    page.until(lambda: page.part("go-on").is_displayed())
    page.part("go-on").click()
    assert asked.wait(60)
    page.served.resume()
    page.until(lambda: not page.part("go-on").is_displayed())


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("focus", ["#parameters input[type=text]", "#span", "body"])
def test_shift_and_the_space_bar_end_the_run_wherever_the_focus_is(page: Page, focus: str) -> None:
    with page.served.ending():
        page.browser.find_element("css selector", focus).send_keys(selenium.Keys.SHIFT, " ")


def test_the_space_bar_alone_ends_nothing(page: Page) -> None:
    page.browser.find_element("css selector", "body").send_keys(" ")
    later(page, 0.2)
    assert page.served.hub.phase == "running"


def test_of_a_run_that_ended_the_reason_is_shown_and_no_button_works(page: Page) -> None:
    page.served.hub.publish("ended", "the cable was unplugged")
    page.until(lambda: page.text("status") == "ended: the cable was unplugged")
    assert not any(one.is_enabled() for one in page.browser.find_elements("css selector", "header button"))


def test_what_watch_rejects_is_among_the_events(page: Page) -> None:
    page.served.hub.publish("rejected", "soft.yaml, line 3: found 'x'")
    page.until(lambda: "soft.yaml, line 3" in page.text("events"))


def test_a_page_from_elsewhere_gets_nothing(page: Page) -> None:
    address = page.served.origin.split("//")[1]
    script = (
        f"const done = arguments[0], socket = new WebSocket('ws://{address}/live');"
        "socket.onopen = () => done('open'); socket.onerror = () => done('refused')"
    )
    assert page.browser.execute_async_script(script) == "open"
    page.browser.get("data:text/html,<title>elsewhere</title>")
    assert page.browser.execute_async_script(script) == "refused"


def type_into(page: Page, name: str, typed: str) -> None:
    box, keys = page.part(f"set {name}").find_element("xpath", "../input[@type='text']"), selenium.Keys
    box.send_keys(keys.CONTROL, "a", keys.NULL, typed, keys.ENTER)


def refusal(page: Page, xpath: str) -> str:
    """Returns the page's error message in the part at the path; "" if there is none."""
    return "".join(one.text for one in page.browser.find_elements("xpath", f"{xpath}/p[@class='refusal']"))


ROW = "//input[@id='set touch.stiffness']/.."


@pytest.fixture
def frequent_counters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "_COUNTERS_S", 0.1)


@pytest.mark.usefixtures("frequent_counters")
@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("typed", "why"), [("9e9", "predicted unstable"), ("-5", "touch.stiffness: found -5")])
def test_a_refused_value_is_shown_with_its_reason_until_another_is_tried(page: Page, typed: str, why: str) -> None:
    type_into(page, "touch.stiffness", typed)
    page.until(lambda: refusal(page, ROW))
    page.served.hub.publish("marker", "something else happens")
    page.served.session.set({"touch": {"damping": 6.0}})
    later(page, 0.3)  # counters come ten times a second
    text = refusal(page, ROW)
    assert f"{float(typed):.0f} N/m was rejected, the value is still 2000 N/m: " in text
    assert why in text
    assert page.value("touch.stiffness") == 2000.0
    box = page.part("set touch.stiffness").find_element("xpath", "../input[@type='text']")
    assert box.get_attribute("value") == "2000"
    type_into(page, "touch.stiffness", "1500")
    page.until(lambda: page.value("touch.stiffness") == 1500.0)
    page.until(lambda: refusal(page, ROW) == "")


def test_a_box_takes_a_quantity_in_another_unit_and_refuses_what_is_no_number_in_words(page: Page) -> None:
    for typed, why in (("1e", "the unknown unit 'e'"), ("2 N", "expected a stiffness")):
        type_into(page, "touch.stiffness", typed)
        page.until(lambda why=why: why in refusal(page, ROW))
    type_into(page, "touch.stiffness", "1.5 N/mm")
    page.until(lambda: page.value("touch.stiffness") == 1500.0)


def test_a_refusal_stays_when_the_controls_are_made_anew_and_goes_when_it_is_closed(page: Page) -> None:
    type_into(page, "touch.stiffness", "9e9")
    page.until(lambda: refusal(page, ROW))
    with page.controls_made_anew():
        page.served.hub.publish("changed")  # the scene may be another: all is asked for again
    assert "was rejected" in refusal(page, ROW)
    page.browser.find_element("xpath", f"{ROW}/p/button").click()
    assert refusal(page, ROW) == ""


def test_a_click_on_the_hand_takes_a_button(page: Page) -> None:
    page.part("click").click()
    events = page.served.hub.events
    page.until(lambda: any(one.kind == "pulse" for one in events))
    pulse = next(one for one in events if one.kind == "pulse")
    assert pulse.values["shape"] == "click"
    assert pulse.values["force"] == 0.2 * page.served.hub.scene.device.force_limit


def test_a_button_without_an_answer_shows_a_message(page: Page) -> None:
    page.served.pause()  # as a device that is away
    page.part("marker").click()
    page.until(lambda: "not armed" in refusal(page, "//header"))
    later(page, 0.3)
    assert "not armed" in refusal(page, "//header")


def test_what_is_asked_while_nobody_answers_is_refused_and_works_again_afterwards(page: Page) -> None:
    """A prediction whose answer the connection lost kept all later ones from being asked for."""
    with page.controls_made_anew():
        page.browser.execute_async_script(
            "const slider = document.getElementById('set touch.stiffness');"
            "import('/panel.js').then(({connection}) => {"
            "connection.ask({type: 'predict', values: {}}).then((answer) => arguments[0](answer.reason));"
            "connection.socket.close();"
            "slider.value = 520; slider.dispatchEvent(new Event('input')); })"
        )
        page.until(lambda: refusal(page, ROW))
    page.slide("touch.stiffness", 0.55, "input")
    page.until(lambda: "not applied yet" in page.text("felt") and refusal(page, ROW) == "")


def test_nothing_leads_from_the_scenes_point_into_the_area_of_another_plane(page: Page) -> None:
    """Felt k and b stand on the axes, and the page says that the area is none of theirs."""
    # Set by another client, and stable; (k, b) lies where no (K, B) is stable.
    page.served.session.set({"touch": {"stiffness": 3500.0}})
    page.until(lambda: page.text("felt").startswith("3500 "))
    record = """
      const done = arguments[0], seen = [], drawn = CanvasRenderingContext2D.prototype, before = {};
      for (const one of ["moveTo", "lineTo", "arc", "fillText"]) {
        before[one] = drawn[one];
        drawn[one] = function (...how) {
          if (this.canvas.id === "plane") seen.push([one, ...how]);
          return before[one].apply(this, how);
        };
      }
      requestAnimationFrame(() => requestAnimationFrame(() => { Object.assign(drawn, before); done(seen); }));
    """
    seen = page.browser.execute_async_script(record)
    texts = {one[1]: one[2:4] for one in seen if one[0] == "fillText"}
    (_, x, y, *_), *_ = (one for one in seen if one[0] == "arc")
    bottom = next(one[2] for one in seen if one[:2] == ["lineTo", x] and one[2] > y)  # of the drop to the axis
    assert {"felt k", "felt b", "K, B of the scene"} <= texts.keys()
    assert texts["felt k"][1] > bottom - 10, "on the axis of stiffness"
    assert texts["felt b"][0] < 58 + 20, "on the axis of damping"
    assert "the area does not apply to them" in page.text("note")


def test_the_region_that_is_shown_is_the_hands(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(DETENT))
    hand = {"stiffness": 1500.0, "damping": 10.0}
    for position, text in ((0.005, "from 2.5 to 7.5 mm: a snap"), (0.01, "from 7.5 to 12.5 mm: stable"),
                           (-0.02, "from -22.5 to -17.5 mm: stable")):  # fmt: skip
        page.served.session.set({"mock.hand": {**hand, "position": position}})
        page.until(lambda text=text: text in page.text("felt"))
    assert "feel like" in page.text("felt")


def test_what_a_hand_touches_is_shown_while_it_moves(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(CELL))
    for position, text in ((0.005, "finger is apart"), (-0.005, "finger is touched"), (0.005, "finger is apart")):
        page.served.session.set({"mock.hand": {"stiffness": 3000.0, "damping": 20.0, "position": position}})
        page.until(lambda text=text: f"At rest here: {text}" in page.text("felt"))
    assert "in all 2 states of its contacts" in page.text("felt")


def test_the_stop_button_is_in_the_first_row_at_every_width(page: Page) -> None:
    try:
        for width, title in product((320, 400, 620, 900, 1280), ("a", "a long name of a scene that somebody gave it")):
            screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
            page.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
            page.browser.execute_script("document.getElementById('title').textContent = arguments[0]", title)
            where = {id: page.part(id).rect for id in ("title", "stop")}
            assert abs(where["stop"]["y"] - where["title"]["y"]) < 20, (width, title)
            assert where["stop"]["x"] + where["stop"]["width"] <= width, (width, title)
            assert page.browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    finally:
        page.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_values_that_differ_from_the_file_are_marked_and_saved(
    browser: Any, serve: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "soft.yaml").write_text(SOFT, encoding="utf-8")
    page = Page(browser, serve(load_scene(tmp_path / "soft.yaml")))

    def marked() -> list[str]:
        labels = "[...document.querySelectorAll('.parameter.unsaved label')]"  # which are made anew once it is saved
        return list(browser.execute_script(f"return {labels}.map((one) => one.textContent)"))

    browser.get_log("browser")  # that of other tests' pages
    assert (marked(), page.text("save")) == ([], "Save")
    page.slide("touch.stiffness", 0.55, "change")
    page.until(lambda: marked() == ["touch.stiffness"])
    assert page.text("save") == "Save 1"
    assert page.part("save").get_attribute("title") == "soft.yaml: touch.stiffness"
    page.part("save").click()
    page.until(lambda: (marked(), page.text("save")) == ([], "Save"))
    assert load_scene(tmp_path / "soft.yaml").modules == page.served.session.scene.modules
    page.part("save-as").click()
    page.until(lambda: browser.switch_to.alert.text == "Name of the new file")
    browser.switch_to.alert.send_keys("softer")
    browser.switch_to.alert.accept()
    page.until(lambda: page.part("save").get_attribute("title").startswith("softer.yaml: "))
    assert page.text("title") == "softer"
    assert load_scene(tmp_path / "softer.yaml").modules == page.served.session.scene.modules
    assert browser.get_log("browser") == []


def test_on_a_phone_the_header_is_one_line_groups_fold_and_no_word_is_cut(
    browser: Any, serve: Callable[..., Any]
) -> None:
    name = "a_wall_with_a_long_name_at_the_end_of_the_travel"
    scene = SOFT.replace("touch:", f"{name}:").replace("damping: 5", "damping: {value: 5, range: [0, 0.02 N·s/mm]}")
    phone = {"width": 375, "height": 667, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        page = Page(browser, serve(scene))
        assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert browser.find_element("tag name", "header").rect["height"] < 60
        page.until(lambda: "Hz" in page.text("count"))
        lines = browser.execute_script(_LINES_OF_LABELS)
        assert any(len(one) > 1 for one in lines), "a long name has several lines"
        assert all(part.endswith((".", "_")) for one in lines for part in one[:-1])
        slider = page.part(f"set {name}.damping")
        slider.send_keys(selenium.Keys.END)
        page.until(lambda: page.value(f"{name}.damping") == 20.0)
        mock = page.part("set mock.hand.force")
        assert (slider.is_displayed(), mock.is_displayed()) == (True, False)
        browser.find_element("xpath", "//summary[text()='Hand of the mock']").click()
        assert mock.is_displayed()
        page.served.hub.publish("changed")  # the controls are made anew, and folded as before
        page.until(lambda: page.part("set mock.hand.force") != mock)
        assert page.part("set mock.hand.force").is_displayed()
        for count, groups in ((12, [["Scene", True]]), (13, [["a", False], ["b", False]])):
            assert browser.execute_async_script(_GROUPS_OF, count) == groups
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


_GROUPS_OF = """
  const [count, done] = arguments, place = document.createElement("div");
  const names = Array.from({ length: count }, (_, i) => `${i < 6 ? "a" : "b"}.k${i}`);
  const own = { kind: "number", value: 1, words: [], span: [0, 2], shown: ["N", 1], least: 0 };
  const each = names.map((name) => ({ name, ...own }));
  import("/controls.js").then(({ makeControls }) => {
    makeControls(place, each, () => {}, () => {});
    done([...place.querySelectorAll("details")].map((one) => [one.firstChild.textContent, one.open]));
  });
"""
_LINES_OF_LABELS = """
  const each = [...document.querySelectorAll(".parameter label")].filter((one) => one.offsetParent);
  return each.map((label) => {
    const lines = [], range = document.createRange();
    for (const node of label.childNodes) for (let i = 0; i < (node.data ?? "").length; i++) {
      range.setStart(node, i); range.setEnd(node, i + 1);
      const { top } = range.getBoundingClientRect();
      if (lines.length && Math.abs(lines[lines.length - 1].top - top) < 4) lines[lines.length - 1].text += node.data[i];
      else lines.push({ top, text: node.data[i] });
    }
    return lines.map((one) => one.text);
  });
"""


@pytest.mark.thorough
def test_a_finger_scrolls_the_page_over_a_canvas_that_it_does_not_drag(page: Page) -> None:
    for id, scrolls in (("scope", "pan-y"), ("plane", "auto")):
        assert page.part(id).value_of_css_property("touch-action") == scrolls
