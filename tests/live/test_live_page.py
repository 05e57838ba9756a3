"""The page of a running scene in a real browser, headless: Debian's Chromium, driven by Selenium."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from live_clients import SCENE

selenium = pytest.importorskip("selenium.webdriver")
if not (shutil.which("chromium") and shutil.which("chromedriver")):
    pytest.skip("Chromium is not installed (Debian: chromium, chromium-driver)", allow_module_level=True)

WAIT_S = 30
SETTINGS = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1280,1000")
QUIET = ("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run")


TWO_HANDS = (
    SCENE
    + """
  right: {type: device, channel: 1}
  other: {type: viscoelastic, between: [right, wall], stiffness: 800, damping: 3}
"""
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    options = selenium.ChromeOptions()
    for one in (*SETTINGS, *QUIET):
        options.add_argument(one)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = selenium.ChromeService(shutil.which("chromedriver"))
    with selenium.Chrome(options=options, service=service) as driver:
        yield driver


class Page:
    """The page of a served scene."""

    def __init__(self, browser: Any, served: Any) -> None:
        self.browser, self.served = browser, served
        browser.get(served.origin)
        self.until(lambda: self.text("title") not in ("", "hapsim") and "feel like" in self.text("felt"))

    def until(self, holds: Callable[[], object]) -> Any:
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.browser, WAIT_S, 0.02).until(lambda _: holds())

    def part(self, id: str) -> Any:
        return self.browser.find_element("id", id)

    def text(self, id: str) -> str:
        return str(self.part(id).text)

    def slide(self, name: str, share: float, event: str) -> None:
        """Moves a slider as a finger does: `input` while it moves, `change` when it leaves it."""
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event(arguments[2]))"
        self.browser.execute_script(script, self.part(f"set {name}"), 1000 * share, event)

    def value(self, name: str) -> float:
        return float(self.served.session.parameters[name].value)


@pytest.fixture
def page(browser: Any, serve: Callable[..., Any]) -> Page:
    return Page(browser, serve())


def test_it_loads_and_nothing_is_logged(page: Page) -> None:
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


def test_what_another_client_changes_is_shown(page: Page) -> None:
    page.served.session.set({"touch": {"stiffness": 1234.0}})
    page.until(lambda: page.text("felt").startswith("1234"))


def test_a_slider_changes_the_force(page: Page) -> None:
    page.served.session.set({"mock.hand": {"force": 2.0}})  # a steady push
    session = page.served.session
    page.until(lambda: abs(session.state().velocity[0]) < 1e-4 and abs(session.state().position[0]) > 5e-4)
    held = session.state().position[0]
    page.slide("touch.stiffness", 0.2, "change")  # softer: the same push goes farther
    page.until(lambda: abs(session.state().position[0]) > 1.5 * abs(held))


def test_a_reload_keeps_the_last_minute(page: Page) -> None:
    page.until(lambda: page.served.session.state().sample > 1500)
    page.browser.refresh()
    page.until(lambda: "feel like" in page.text("felt"))
    seen = (
        "const done = arguments[0];"
        "import('/panel.js').then(({samples}) => done([samples.count * samples.period, performance.now() / 1000]))"
    )
    page.until(lambda: page.browser.execute_async_script(seen)[0] > 0.0)
    shown_s, open_s = page.browser.execute_async_script(seen)
    assert shown_s > open_s + 0.5  # more than since the page was opened: what came before, too


def test_the_mock_follows_a_dragged_handle(page: Page) -> None:
    from selenium.webdriver import ActionChains

    session = page.served.session
    session.set({"touch": {"stiffness": 100.0}})
    drag = ActionChains(page.browser).move_to_element(page.part("handle")).click_and_hold().move_by_offset(150, 0)
    drag.perform()
    page.until(lambda: session.state().position[0] > 2e-3)
    ActionChains(page.browser).release().perform()
    page.until(lambda: page.value("mock.hand.stiffness") == 0.0)


def choose(page: Page, id: str, value: str) -> None:
    script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event(arguments[2]))"
    page.browser.execute_script(script, page.part(id), value, "input" if id == "level" else "change")


def scope(page: Page, what: str) -> Any:
    """The value of an expression in the page's `scope` and `samples`."""
    script = f"const done = arguments[0]; import('/panel.js').then(({{scope, samples}}) => done({what}))"
    return page.browser.execute_async_script(script)


def test_a_single_shot_freezes_where_the_level_is_crossed(page: Page) -> None:
    session = page.served.session
    session.set({"mock.hand": {"stiffness": 500.0, "damping": 5.0, "position": -0.004}})
    page.until(lambda: session.state().position[0] < -5e-4)
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
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    page.until(lambda: scope(page, "samples.count") > 1500)
    origin = ScrollOrigin.from_element(page.part("scope"))
    ActionChains(page.browser).scroll_from_origin(origin, 0, -500).perform()
    page.until(lambda: scope(page, "scope.spanS") < 1.0)
    ActionChains(page.browser).move_to_element(page.part("scope")).click_and_hold().move_by_offset(
        120, 0
    ).release().perform()
    page.until(lambda: scope(page, "scope.isFrozen && scope.frozenAt < samples.count - 100"))
    ActionChains(page.browser).double_click(page.part("scope")).perform()
    page.until(lambda: scope(page, "[scope.spanS, scope.isFrozen]") == [2, False])


def test_a_module_is_watched_many_times_a_second(page: Page) -> None:
    choose(page, "what", "module wall")
    page.until(lambda: scope(page, "samples.rows") > 500)
    page.served.session.set({"wall": {"position": 0.0015}})
    page.until(
        lambda: scope(page, "samples.places[(samples.rows - 1) % samples.places.length]") == pytest.approx(0.0015)
    )
    rows, apart = scope(page, "[samples.rows, samples.at[samples.rows - 1] - samples.at[samples.rows - 101]]")
    assert apart < 100 / 0.1, f"100 of {rows} rows in {apart} samples: more than a hundred a second"


def test_how_steady_it_runs_is_drawn(page: Page) -> None:
    drawn = "[...arguments[0].getContext('2d').getImageData(0, 30, arguments[0].width, 40).data].some((one) => one > 0)"
    for id in ("exchange", "lateness"):
        page.until(lambda id=id: page.browser.execute_script(f"return {drawn}", page.part(id)))


def test_each_hand_has_its_plane(browser: Any, serve: Callable[..., Any]) -> None:
    served = serve(TWO_HANDS)
    page = Page(browser, served)
    assert page.text("felt").startswith("2000 ")
    choose(page, "hand", "right")
    page.until(lambda: page.text("felt").startswith("800 "))


def test_the_space_bar_ends_the_run_wherever_the_focus_is(page: Page) -> None:
    page.browser.find_element("css selector", "#parameters input[type=number]").send_keys(" ")
    page.until(lambda: page.served.session.progress().phase == "ended")


def test_a_page_from_elsewhere_gets_nothing(page: Page) -> None:
    address = page.served.origin.split("//")[1]
    script = (
        f"const done = arguments[0], socket = new WebSocket('ws://{address}/live');"
        "socket.onopen = () => done('open'); socket.onerror = () => done('refused')"
    )
    assert page.browser.execute_async_script(script) == "open"
    page.browser.get("data:text/html,<title>elsewhere</title>")
    assert page.browser.execute_async_script(script) == "refused"
