"""The pictures of the page: the scene as it moves, the force over position, the dial; and what is dragged in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from live_clients import PLANE, SOFT
from live_page import Page, later, scope, selenium


def on_picture(page: Page, name: str) -> Any:
    """Moves the mouse to where a point or a mass of a structure is in the picture."""
    page.until(lambda: scope(page, "picture.row") is not None)
    canvas = page.part("picture")
    page.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    x, y = page.until(lambda: scope(page, f"picture.view.spots.get('{name}')"))
    middle = canvas.size["width"] / 2, canvas.size["height"] / 2
    return selenium.ActionChains(page.browser).move_to_element_with_offset(canvas, x - middle[0], y - middle[1])


def test_what_is_clicked_in_the_picture_is_plotted(browser: Any, serve: Callable[..., Any]) -> None:
    gut = "  gut: {type: string, masses: 8, mass: 0.001, stiffness: 300, damping: 0.01}\n"
    page = Page(browser, serve(SOFT.replace("velocity: 0.1", "velocity: 0.0") + gut))
    for name, plotted in (("gut.5", "module gut"), ("hand", "0 0"), ("gut.2", "module gut"), ("wall", "module wall")):
        on_picture(page, name).click().perform()
        page.until(lambda plotted=plotted: page.part("what").get_attribute("value") == plotted)
        if name.startswith("gut"):
            assert page.part("place").get_attribute("value") == name[4:]
    assert browser.get_log("browser") == []


def test_each_of_several_hands_is_dragged(browser: Any, serve: Callable[..., Any]) -> None:
    right = "right: {type: device, channel: 1}"
    other = "other: {type: viscoelastic, between: [right, hand], stiffness: 20, damping: 3}"
    page = Page(browser, serve(f"{SOFT}  {right}\n  {other}\n"))
    session = page.served.session
    for name, channel in (("right", 1), ("hand", 0)):
        on_picture(page, name).click_and_hold().move_by_offset(0, -60).perform()
        held = tuple(200.0 * (c == channel) for c in range(2))
        page.until(lambda held=held: session.parameters["mock.hand.stiffness"].value == held)
        page.until(lambda channel=channel: session.state().position[channel] > 2e-3)
        selenium.ActionChains(browser).release().perform()
        page.until(lambda: session.parameters["mock.hand.stiffness"].value == (0.0, 0.0))


def test_a_hand_of_the_plane_follows_a_drag_and_the_arrow_keys_in_both_coordinates(
    browser: Any, serve: Callable[..., Any]
) -> None:
    page = Page(browser, serve(PLANE))
    session, picture = page.served.session, page.part("picture")
    assert "hand feels 0 N/m and 1 N·s/m along 0°" in page.text("felt")
    page.until(lambda: picture.size["height"] == picture.size["width"] > 100)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", picture)
    before = np.array(session.state().position)
    drag = selenium.ActionChains(browser).move_to_element_with_offset(picture, -80, 40).click_and_hold()
    drag.move_by_offset(-20, 30).perform()
    # What there is about the post, box, hand and ball, is 0.1 m wide: with its room 0.13 m are as wide as the canvas.
    metres = 0.13 / picture.size["width"]
    to = np.array([0.03 - 100 * metres, -70 * metres])
    page.until(lambda: session.parameters["mock.hand.stiffness"].value == (200.0, 200.0))
    page.until(lambda: np.abs(session.parameters["mock.hand.position"].value - to).max() < 1.5 * metres)
    to = np.array(session.parameters["mock.hand.position"].value)
    page.until(lambda: np.abs(session.state().position - to).max() < 1e-4)
    assert np.abs(to - before).min() > 1e-3
    selenium.ActionChains(browser).release().perform()
    page.until(lambda: session.parameters["mock.hand.stiffness"].value == (0.0, 0.0))
    picture.click()
    for key, axis, way in (
        (selenium.Keys.ARROW_DOWN, 1, -1),
        (selenium.Keys.ARROW_LEFT, 0, -1),
        (selenium.Keys.ARROW_UP, 1, 1),
    ):
        at = session.state().position[axis]
        selenium.ActionChains(browser).key_down(key).perform()
        page.until(lambda at=at, axis=axis, way=way: way * (session.state().position[axis] - at) > 1e-3)
        selenium.ActionChains(browser).key_up(key).perform()
        page.until(lambda: session.parameters["mock.hand.stiffness"].value == (0.0, 0.0))
    assert browser.get_log("browser") == []


def test_the_plane_shows_its_outlines_where_the_points_are(browser: Any, serve: Callable[..., Any]) -> None:
    page = Page(browser, serve(PLANE))
    session = page.served.session
    inked = """
        const canvas = document.getElementById("picture"), [x, y] = arguments, scale = canvas.width / 0.13;
        const at = (value, middle) => Math.round(canvas.width / 2 + (value - middle) * scale);
        const pixels = canvas.getContext("2d").getImageData(at(x, 0.03) - 2, at(-y, 0) - 2, 5, 5).data;
        return pixels.filter((_, i) => i % 4 === 3).reduce((most, one) => Math.max(most, one), 0)"""

    def ink(x: float, y: float) -> int:
        return int(browser.execute_script(inked, x, y))

    page.until(lambda: ink(0.03, 0.02) > 200)  # the top of the disc
    assert ink(0.05, 0.0) > 200
    assert 0 < ink(0.035, 0.015) < 100  # within it
    assert ink(0.08, 0.03) > 200  # the box of the ball,
    assert ink(0.0, 0.03) > 200  # the ball,
    assert ink(0.06, 0.03) == 0  # and nothing
    page.served.hub.adopt(PLANE.replace("{disc: 0.02}", "{disc: 0.012}"))
    page.until(lambda: ink(0.03, 0.012) > 200)
    assert ink(0.03, 0.02) == 0
    session.set({"post.y": {"position": 0.01}})
    page.until(lambda: ink(0.03, 0.022) > 200)
    assert 0 < ink(0.03, 0.016) < 100


KNOB = """
version: 1
rate: 1000
device: {clock: host, motion: rotary, mass: 5.0e-5, friction: 5.0e-4, force_limit: 0.3}
modules:
  knob: {type: device, channel: 0}
  frame: {type: ground}
  detent: {type: detent, between: [knob, frame], pitch: 15 deg, depth: 0.001, damping: 0.002, hold_until: 0.6}
"""
RECORD = """
  const [id, done] = arguments, seen = [], drawn = CanvasRenderingContext2D.prototype, before = {};
  for (const one of ["beginPath", "moveTo", "lineTo", "arc", "fillText", "setLineDash"]) {
    before[one] = drawn[one];
    drawn[one] = function (...how) {
      if (this.canvas.id === id) seen.push([one, ...how]);
      return before[one].apply(this, how);
    };
  }
  requestAnimationFrame(() => requestAnimationFrame(() => { Object.assign(drawn, before); done(seen); }));
"""


def texts(page: Page, id: str) -> list[str]:
    """Returns what is written in a picture."""
    return [one[1] for one in page.browser.execute_async_script(RECORD, id) if one[0] == "fillText"]


def curves(page: Page) -> tuple[Any, Any, Any]:
    """Returns points of the curve of the force, those of the planned one, and the dot, px. Axes and edges are single
    lines, which begin with a move."""
    applied: list[Any] = []
    planned: list[Any] = []
    dot, is_dashed, is_curve = None, False, False
    for what, *how in page.browser.execute_async_script(RECORD, "force"):
        is_curve = what == "beginPath" or (is_curve and what == "lineTo")
        if what == "setLineDash":
            is_dashed = how[0] == [5, 4]
        elif what == "lineTo" and is_curve:
            (planned if is_dashed else applied).append(how[:2])
        elif what == "arc":
            dot = how[:2]
    return np.array(applied), np.array(planned), dot


def test_a_dial_is_turned_by_the_mouse_and_by_a_finger_over_several_turns(
    browser: Any, serve: Callable[..., Any]
) -> None:
    page = Page(browser, serve(KNOB))
    session, dial = page.served.session, page.part("dial")
    assert not page.part("picture-part").is_displayed()
    page.until(dial.is_displayed)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", dial)
    radius = 0.35 * dial.size["height"]
    drag = selenium.ActionChains(browser, duration=50).move_to_element_with_offset(dial, 0, -int(radius))
    drag.click_and_hold()
    for angle in np.radians(np.arange(40, 481, 40)):
        drag.move_to_element_with_offset(dial, int(radius * np.sin(angle)), -int(radius * np.cos(angle)))
    drag.perform()
    page.until(lambda: abs(page.value("mock.hand.position") - np.radians(480)) < 0.3)
    page.until(lambda: session.state().position[0] > np.radians(450))
    page.until(lambda: any(text.startswith("1 turn and ") for text in texts(page, "dial")))
    page.until(lambda: "held" in texts(page, "force"))
    selenium.ActionChains(browser).release().perform()
    page.until(lambda: page.value("mock.hand.stiffness") == 0.0)

    def finger(kind: str, *places: tuple[float, float]) -> None:
        box = dial.rect
        top = browser.execute_script("return arguments[0].getBoundingClientRect().top", dial)
        points = [{"x": box["x"] + box["width"] / 2 + x, "y": top + box["height"] / 2 + y} for x, y in places]
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    at = session.state().position[0]
    finger("touchStart", (radius, 0.0))
    for angle in np.radians([-30.0, -60.0, -90.0]):
        finger("touchMove", (radius * np.cos(angle), radius * np.sin(angle)))
    page.until(lambda: session.state().position[0] < at - np.radians(60))
    finger("touchEnd")
    page.until(lambda: page.value("mock.hand.stiffness") == 0.0)


def test_the_dot_of_a_hand_at_rest_is_on_the_curve_and_a_moved_slider_shows_its_own(
    browser: Any, serve: Callable[..., Any]
) -> None:
    page = Page(browser, serve(f"{SOFT}  stop: {{type: buffer, between: [hand, wall], stiffness: 30}}\n"))
    session, canvas = page.served.session, page.part("force")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    selenium.ActionChains(browser).move_to_element_with_offset(
        canvas, -int(0.35 * canvas.size["width"]), 0
    ).click_and_hold().perform()
    page.until(lambda: session.state().position[0] < -1e-5 and abs(session.state().velocity[0]) < 1e-5)
    later(page, 0.2)  # the picture follows

    def off(curve: Any, dot: Any) -> float:
        return float(abs(np.interp(dot[0], curve[:, 0], curve[:, 1]) - dot[1]))

    page.until(lambda: (found := curves(page))[2] is not None and off(found[0], found[2]) < 1.0)
    applied, planned, (_, y) = curves(page)
    assert len(planned) == 0
    limited = "import('/force.js').then(({limited}) => arguments[0](limited([0, 1, 2], [-1, 4, -4], 2)))"
    assert browser.execute_async_script(limited) == [[0, -1], [0.6, 2], [1, 2], [1.25, 2], [1.75, -2], [2, -2]]
    assert y > applied[-1, 1] + 5, "it presses the contact"
    page.slide("stop.stiffness", 0.4, "input")

    def is_as_it_feels() -> bool:
        applied, planned, dot = curves(page)
        softer = len(planned) > 0 and np.interp(dot[0], planned[:, 0], planned[:, 1]) < dot[1] - 3
        return bool(softer and off(applied, dot) < 1.0)  # still the force of now; a softer contact pushes less

    page.until(is_as_it_feels)
    selenium.ActionChains(browser).release().perform()
    page.slide("stop.stiffness", 0.4, "change")
    page.until(lambda: len(curves(page)[1]) == 0)
