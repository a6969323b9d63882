"""The page of the real service in a real browser: buttons, lost connection, return, reload."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import signal
import time
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from page_bench import Bench, served, snapshot
from page_service import serving
from real_time import real_time
from required_programs import need
from waiting import MAX_WAIT_S, until

from flying_vines.core.events import Decision
from flying_vines.core.pending_bend import PendingBend
from flying_vines.core.request_lines import FIRST_PERIOD_S
from flying_vines.core.snapshot import Snapshot
from flying_vines.gateway import page_token
from flying_vines.supply import CyclesLeft

if TYPE_CHECKING:
    from playwright.async_api import Browser, Page

pytestmark = [real_time, pytest.mark.long]

PHONE: dict[str, Any] = {
    "viewport": {"width": 360, "height": 640},
    "device_scale_factor": 2,
    "has_touch": True,
    "is_mobile": True,
}
DESKTOP: dict[str, Any] = {"viewport": {"width": 1440, "height": 900}, "reduced_motion": "reduce"}
THUMB_PX = 48
LIVE = "body:not(.stale)"
WATCH_SHIFTS = """() => {
    window.shifts = [];
    new PerformanceObserver(list => list.getEntries().forEach(shift => {
        // The log is to move: its latest is on top.
        const moved = shift.sources.map(({ node }) => node).filter(node => !node?.closest?.("#events"));
        const names = moved.map(node => node?.id || node?.nodeName);
        if (moved.length && shift.value > 0.002) window.shifts.push([shift.value, names]);
    })).observe({ type: "layout-shift", buffered: true });
}"""
DRAWN = """() => {
    const chart = document.querySelector("#chart");
    const dots = chart.getContext("2d").getImageData(0, 0, chart.width, chart.height).data;
    const [red, green, blue] = [0x0b, 0x4f, 0xa8];  // --vine
    for (let i = 0; i < dots.length; i += 4)
        if (dots[i] === red && dots[i + 1] === green && dots[i + 2] === blue) return true;
    return false;
}"""


class Proxy:
    """The proxy for requests that are not for this machine. It records them and does not answer."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.port = 0

    async def take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.asked.append((await reader.readline()).decode(errors="replace").strip())
        writer.close()


@pytest.fixture
async def proxy() -> AsyncIterator[Proxy]:
    proxy = Proxy()
    server = await asyncio.start_server(proxy.take, "127.0.0.1")
    proxy.port = server.sockets[0].getsockname()[1]
    yield proxy
    server.close()


@pytest.fixture
async def browser() -> AsyncIterator[Browser]:
    chromium = need("chromium", "sudo apt install chromium")
    playwright = pytest.importorskip(
        "playwright.async_api", reason="needs playwright: pip install playwright"
    )
    async with playwright.async_playwright() as started:
        browser = await started.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        await browser.close()


async def opened(browser: Browser, url: str, device: Mapping[str, Any]) -> tuple[Page, list[str]]:
    """A new visitor's page, and its errors."""
    context = await browser.new_context(**device)
    context.set_default_timeout(1000.0 * MAX_WAIT_S)
    page = await context.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text) if "Content Security" in said.text else None)
    await page.goto(url)
    await page.wait_for_selector(LIVE)
    return page, wrong


async def until_shown(page: Page, selector: str, text: str) -> None:
    await page.wait_for_function(
        "([selector, text]) => document.querySelector(selector).textContent.includes(text)",
        arg=[selector, text],
    )


async def test_on_a_phone_a_thumb_tries_the_vine_and_vents(
    browser: Browser, proxy: Proxy, tmp_path: Path
) -> None:
    async with serving(tmp_path) as served:
        page, wrong = await opened(
            browser,
            served.url,
            {**PHONE, "proxy": {"server": f"http://127.0.0.1:{proxy.port}", "bypass": "127.0.0.1"}},
        )
        bench = served.bench
        await until_shown(page, "#firmware", "ready")
        assert await page.get_by_role("button", name="bend-full").is_disabled()
        await page.evaluate(WATCH_SHIFTS)

        await page.tap("#bench-mode")
        await until_shown(page, "#said", "bench mode: accepted")
        await page.get_by_role("button", name="bend-full").tap()
        await until(bench.bent, "the vine bends")
        await page.wait_for_function("() => Number(document.querySelector('#bend').textContent) > 40")
        assert "M" in str(await page.get_attribute("#body", "d"))
        await page.tap("#vent")
        await until_shown(page, "#vent-said", "Vent confirmed")
        await until(bench.vented, "the vine is vented")

        await page.get_by_role("button", name="bend-full").tap()
        await until(bench.bent, "the vine bends again")
        os.kill(served.pid, signal.SIGSTOP)
        await until(bench.vented, "the dead-man vents")
        os.kill(served.pid, signal.SIGCONT)
        await until_shown(page, "#reasons", "dead-man")
        await page.tap("#clear")
        await until_shown(page, "#clear", "Sure?")
        await page.tap("#clear")
        await until_shown(page, "#reasons", "a new request")

        await page.fill("#angle", "20")
        await page.tap("#bend-to")
        await page.wait_for_function("() => Number(document.querySelector('#bend').textContent) > 10")
        await page.tap("#armed")
        await until_shown(page, "#said", "disarm: accepted")
        await until(bench.vented, "disarmed is vented")
        await page.tap("#bend-to")
        await until_shown(page, "#said", "refused, the pneumatics are disarmed")
        await page.tap("#armed")
        await page.tap("#armed")
        await until_shown(page, "#said", "arm: accepted")

        assert not await page.evaluate("shifts")
        await _fits(page)
        await page.evaluate("scrollTo(0, document.body.scrollHeight)")
        await _fits(page)
        assert not wrong
        assert not proxy.asked
        with contextlib.suppress(Exception):
            await page.goto("http://elsewhere.invalid/")
        assert any("elsewhere.invalid" in asked for asked in proxy.asked), "or nobody listened"


async def _fits(page: Page) -> None:
    """Nothing is wider than the screen, VENT is on it, and all buttons are large enough."""
    assert await page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert await page.evaluate(
        "(() => { const r = document.querySelector('#vent').getBoundingClientRect();"
        " return r.top > 0 && r.bottom <= innerHeight && r.height >= 60 })()"
    )
    small = await page.evaluate(
        "least => [...document.querySelectorAll('button, input')].filter(e => e.offsetParent &&"
        " e.getBoundingClientRect().height < least).map(e => e.id || e.textContent)",
        THUMB_PX,
    )
    assert not small


async def test_a_link_that_is_cut_is_seen_and_comes_back(browser: Browser, tmp_path: Path) -> None:
    async with serving(tmp_path) as served:
        page, wrong = await opened(browser, served.url, DESKTOP)
        await until_shown(page, "#events", "phloSAR ready")

        # The network loses everything, but no connection is closed.
        os.kill(served.gateway, signal.SIGSTOP)
        await page.wait_for_selector("body.lost")
        await until_shown(page, "#link", "old")
        os.kill(served.gateway, signal.SIGCONT)
        await page.wait_for_selector(LIVE)

        # The page's process dies, and the service starts it again.
        os.kill(served.gateway, signal.SIGKILL)
        await page.wait_for_selector("body.lost")
        await until_shown(page, "#link", "No link")
        await page.wait_for_selector(LIVE)

        # The service dies, and a person wants to vent.
        await served.kill()
        await page.wait_for_selector("body.lost")
        await page.keyboard.press("Escape")
        await until_shown(page, "#vent-said", "VENT not sent, no link")
        assert await page.locator("#bench-mode").is_disabled()
        await served.start()
        await until_shown(page, "#vent-said", "Vent confirmed")
        await page.wait_for_selector(LIVE)
        await until_shown(page, "#events", "page → vent: accepted")

        # Space always vents, whatever has the focus, and presses no button. An equal line is only counted for
        # some seconds.
        await asyncio.sleep(FIRST_PERIOD_S + 0.5)
        await page.focus("#bench-mode")
        await page.keyboard.press("Space")
        assert await page.get_attribute("#bench-mode", "aria-checked") == "false"
        await page.wait_for_function("() => document.querySelectorAll('#events .accepted').length >= 2")

        # A page that is loaded anew shows the earlier events, some seconds after the restart of the service.
        hello: dict[str, Any] = {}
        for _ in range(round(MAX_WAIT_S)):
            hello = await _greeting(page)
            await until_shown(page, "#events", "page → vent: accepted")
            if len(hello["history"]) > 5:
                break
            await asyncio.sleep(1.0)
        assert len(hello["history"]) > 5
        await page.wait_for_selector(LIVE)
        await page.wait_for_function(DRAWN)
        await _fits(page)
        assert not wrong


async def test_a_request_has_its_time_and_the_shown_state(browser: Browser, tmp_path: Path) -> None:
    async with serving(tmp_path) as served:
        page, wrong = await opened(browser, served.url, DESKTOP)
        sent: list[dict[str, Any]] = []
        page.on(
            "websocket",
            lambda socket: socket.on("framesent", lambda frame: sent.append(json.loads(frame))),
        )
        await page.reload()
        await page.wait_for_selector(LIVE)
        await page.click("#bench-mode")
        await until_shown(page, "#said", "bench mode: accepted")
        (pressed,) = sent
        assert time.monotonic() - MAX_WAIT_S < pressed["seen_at"] <= pressed["made_at"] <= time.monotonic()

        # The shown state does not change but gets older. A vent reports that there is nothing newer.
        os.kill(served.pid, signal.SIGSTOP)
        await page.wait_for_selector("body.lost")
        await until_shown(page, "#vent-said", "Vine pressure not known")
        await page.click("#vent")
        await page.wait_for_timeout(1200)
        os.kill(served.pid, signal.SIGCONT)
        await until_shown(page, "#vent-said", "Vent confirmed")
        vents = [request for request in sent if request["command"] == "vent"]
        assert len(vents) > 1
        assert len({vent["seen_at"] for vent in vents}) == 1
        assert all(vent["made_at"] - vent["seen_at"] > 0.9 for vent in vents[:2])
        assert not wrong


SWITCH = PendingBend("vent by the page", "switch down, then up")
PLENTY = CyclesLeft(1234.0, 1000.0, 1500.0, 3.0, 9.0, 80.0, 15.0, 1.2, 600.0, 450.0, 600.0)
FAULTS = {
    "firmware_fault": "firmware fault: dead-man timer ran out, over-pressure in the vine, watchdog reset",
    "rc": "RC lost: the receiver hears no transmitter",
    "reservoir_loss": "reservoir loses 22 kPa/s too much",
}
STATES = {
    "bent": snapshot(doing="bend-full", command_kPa=20.0, cv_kPa=20.1, bend_deg=58.0, cycles=PLENTY),
    "waiting": snapshot(waiting=SWITCH, cycles=PLENTY),
    "faults": snapshot(
        waiting=SWITCH, cycles=PLENTY, safe_state=FAULTS, rc="the receiver hears no transmitter"
    ),
}
CUT = """() => {
    const foot = document.querySelector("footer").getBoundingClientRect().top;
    const shown = document.createRange();
    return [...document.querySelectorAll("#doing, #reasons, .facts, #cycles, #vent-said")].filter(e => {
        shown.selectNodeContents(e);
        const low = shown.getBoundingClientRect().bottom > (e.id === "vent-said" ? innerHeight : foot);
        const cut = e.scrollHeight > e.clientHeight || e.scrollWidth > e.clientWidth;
        return low || (cut && getComputedStyle(e).overflowY !== "visible");
    }).map(e => e.id || e.className);
}"""


@contextlib.asynccontextmanager
async def showing(bench: Bench, shown: Snapshot) -> AsyncIterator[None]:
    """The service sends this snapshot repeatedly."""

    async def say() -> None:
        while True:
            bench.show(dataclasses.replace(shown, t=time.monotonic()))
            await asyncio.sleep(0.1)

    saying = asyncio.create_task(say())
    yield
    saying.cancel()


@pytest.mark.parametrize("size", [(320, 640), (390, 844), (768, 1024), (1280, 720)], ids=str)
async def test_problems_and_cycles_left_are_visible_without_scrolling(
    browser: Browser, size: tuple[int, int]
) -> None:
    device = {"viewport": dict(zip(("width", "height"), size, strict=True))}
    async with served() as bench:
        async with showing(bench, STATES["bent"]):
            page, _ = await opened(browser, bench.url, device)
            await page.click("#vent")
            await until_shown(page, "#vent-said", "Vent confirmed")
        for name, shown in STATES.items():
            async with showing(bench, shown):
                await page.wait_for_timeout(300)
                assert not await page.evaluate(CUT), name
                await _fits(page)
                said = await page.inner_text("#reasons")
                assert all(reason[1:] in said for reason in shown.safe_state.values())
                assert (SWITCH.awaited in said) == (shown.waiting is not None)
                assert ("Nothing is wrong" in said) == (name == "bent")
                assert "1481 bends to 15 kPa left" in await page.inner_text("#cycles")


async def test_params_have_six_digits_and_an_unused_one_is_a_dash(browser: Browser) -> None:
    item = {"seq": 3, "command": 31010, "params": [0.10000000149011612, math.nan, -45.0, 2.0]}
    async with served() as bench, showing(bench, STATES["bent"]):
        page, wrong = await opened(browser, bench.url, DESKTOP)
        bench.happen(Decision(2.0, "mission_item", item, "wave", "accepted", "", 20.0))
        await until_shown(page, "#events", "wave: accepted")
        assert "mission item #3 31010 (0.1, –, -45, 2) → wave" in await page.inner_text("#events")
        assert not wrong


async def test_a_confirmed_vent_is_not_shown_for_ever(browser: Browser) -> None:
    async with served() as bench, showing(bench, STATES["bent"]):
        page, _ = await opened(browser, bench.url, DESKTOP)
        await page.clock.install()
        await page.click("#vent")
        await until_shown(page, "#vent-said", "Vent confirmed")
        await page.clock.fast_forward(11_000)
        await until_shown(page, "#vent-said", "Vine at")


async def _greeting(page: Page) -> dict[str, Any]:
    """Load the page anew. Returns the first message."""
    async with page.expect_event("websocket") as told:
        await page.reload()
    frame = await (await told.value).wait_for_event("framereceived")
    greeting: dict[str, Any] = json.loads(frame)
    return greeting


async def test_from_the_network_by_token_and_watching_only(browser: Browser, tmp_path: Path) -> None:
    async with serving(tmp_path, host="0.0.0.0") as served:
        token = page_token.read(tmp_path / "vine.page-token")
        refused = await (await browser.new_context()).new_page()
        await refused.goto(served.url)
        assert "needs a token" in await refused.inner_text("body")
        await refused.fill("input", token.upper().replace("-", " "))
        await refused.click("button")
        await refused.wait_for_selector(LIVE)
        assert refused.url == served.url
        assert await refused.evaluate("document.cookie") == ""
        await refused.reload()
        await refused.wait_for_selector(LIVE)
        assert await refused.is_visible("#vent")

        watching = page_token.watching(token)
        page, wrong = await opened(browser, f"{served.url}?token={watching}", PHONE)
        assert not await page.is_visible("#vent")
        assert not await page.is_visible("#bench-mode")
        await until_shown(page, "#vent-said", "only watch")
        assert not wrong
