"""The page of a served scene in a real browser, headless: Debian's Chromium, driven by Selenium."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest

selenium = pytest.importorskip("selenium.webdriver")
if not (shutil.which("chromium") and shutil.which("chromedriver")):
    pytest.skip("Chromium is not installed (Debian: chromium, chromium-driver)", allow_module_level=True)

WAIT_S = 30
SETTINGS = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1280,1000")
QUIET = ("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run")


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """Starts the browser; ends it with the block."""
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
        browser.get_log("browser")  # of the page before
        browser.get(served.origin)
        self.until(lambda: self.text("title") not in ("", "hapsim") and self.is_predicted())

    def is_predicted(self) -> bool:
        return any(words in self.text("felt") for words in ("feel like", "states of its contacts", "feels"))

    def until(self, holds: Callable[[], object]) -> Any:
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.browser, WAIT_S, 0.02).until(lambda _: holds())

    def part(self, id: str) -> Any:
        return self.browser.find_element("id", id)

    def text(self, id: str) -> str:
        return str(self.part(id).text)

    def slide(self, name: str, share: float, event: str) -> None:
        """Moves a slider as a finger does: `input` while it moves, `change` when it leaves it. In one script, because
        the page makes its sliders anew when it connects again."""
        script = (
            "const slider = document.getElementById(arguments[0]);"
            "slider.value = arguments[1]; slider.dispatchEvent(new Event(arguments[2]))"
        )
        self.browser.execute_script(script, f"set {name}", 1000 * share, event)

    @contextlib.contextmanager
    def controls_made_anew(self) -> Iterator[None]:
        """Waits until the page has replaced its controls, as it does when it has received another model."""
        marked = "document.getElementById('set touch.stiffness').dataset.isBefore"
        self.browser.execute_script(f"{marked} = 'yes'")
        yield
        self.until(lambda: self.browser.execute_script(f"return {marked}") is None)

    def value(self, name: str) -> float:
        return float(self.served.session.parameters[name].value)


def later(page: Page, seconds: float) -> None:
    """Waits, by the page's own clock, for pictures and figures that replace others."""
    page.browser.execute_async_script("setTimeout(arguments[1], arguments[0])", 1000 * seconds)


def scope(page: Page, what: str) -> Any:
    """The value of an expression in the page's `scope`, `samples` and `picture`."""
    script = f"const done = arguments[0]; import('/panel.js').then(({{scope, samples, picture}}) => done({what}))"
    return page.browser.execute_async_script(script)
