"""The page for operators in Debian's chromium, beside gateways that can be killed."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests.benches.free_port import free_port

_CHROMIUM = Path("/usr/bin/chromium")
LIMIT_MS = 120_000.0
"""The limit for what takes a second, and more on a busy computer."""
SCREENS = ((1400, 900), (1024, 600), (390, 844))
"""Width and height: a desktop, a 10-inch panel, a phone."""
MILL_SETTINGS = "[machine.mill]\ntolerance_um = 8.0\nsphere_radius_mm = 200.0\n"


class ChildProgram:
    """A program of this tree that talks in lines.

    Parameters
    ----------
    arguments: after `python -m`
    log: what it says goes there, and is not heard
    """

    def __init__(self, *arguments: str, log: Path | None = None) -> None:
        with ExitStack() as stack:
            out = None if log is None else stack.enter_context(log.open("ab"))
            self._process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE if out is None else out, stderr=out, text=True, bufsize=1,
            )  # fmt: skip

    def hear(self) -> str:
        """Its next line."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the program ended"
        return line.strip()

    def say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")

    @property
    def pid(self) -> int:
        """Its number in /proc."""
        return self._process.pid

    def interrupt(self) -> None:
        """Interrupt it as Ctrl-C does; returns when it has ended."""
        self._process.send_signal(signal.SIGINT)
        self._process.communicate()

    def kill(self) -> None:
        """Kill it, as a power cut does."""
        self._process.kill()
        self._process.communicate()


class PageRig:
    """One web process and its gateways.

    Parameters
    ----------
    browser: that opens pages
    stack: ends everything
    """

    def __init__(self, browser: Browser, stack: ExitStack) -> None:
        self._browser, self._stack = browser, stack
        self.address = ""
        self.web: ChildProgram | None = None

    def gateway(self, port: int, machine: str, what: str = "all") -> ChildProgram:
        """Alive, and silent until a line is said to it."""
        found = self._started("tests.benches.played_telemetry", str(port), machine, what)
        assert found.hear() == "listening"
        return found

    def commanded_gateway(self, port: int, machine: str, operator: str, key_file: Path) -> ChildProgram:
        """A gateway that takes an operator's commands."""
        found = self._started("tests.benches.commanded_gateway", str(port), machine, operator, str(key_file))
        assert found.hear() == "listening"
        return found

    def live_machine(self, folder: Path) -> tuple[ChildProgram, dict[str, int]]:
        """An emulated machine whose wires break on request, and its TCP ports."""
        found = self._started("tests.benches.live_machine", str(folder))
        return found, json.loads(found.hear())

    def live_gateway(self, config: Path) -> ChildProgram:
        """The service itself. Its log goes to a file beside its configuration."""
        return self._started("gateway", "run", str(config), log=config.with_suffix(".log"))

    def serve(self, ports: Sequence[int], settings: Path) -> None:
        """Start the page's program."""
        connect = [word for port in ports for word in ("--connect", f"tcp/127.0.0.1:{port}")]
        settled = ["--settings", str(settings), "--listen", "127.0.0.1:0"]
        self.web = self._started("gateway", "web", *connect, *settled)
        self.address = self.web.hear()

    def _started(self, *arguments: str, log: Path | None = None) -> ChildProgram:
        program = ChildProgram(*arguments, log=log)
        self._stack.callback(program.kill)
        return program

    @contextmanager
    def page(
        self,
        path: str,
        width: int = 1400,
        height: int = 900,
        *,
        dark: bool = False,
        locale: str = "en-GB",
        trusted: bool = False,
        user: tuple[str, str] | None = None,
        zone: str = "Europe/Zurich",
    ) -> Iterator[Page]:
        """An open page. Fails on any message in the browser's console, such as of the Content-Security-Policy.

        trusted: the policy does not hold, for scripts of the test
        user: name and password
        zone: the browser's time zone
        """
        context: BrowserContext = self._browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme="dark" if dark else "light",
            locale=locale,
            timezone_id=zone,
            bypass_csp=trusted,
            http_credentials=None if user is None else {"username": user[0], "password": user[1], "send": "always"},
        )
        context.set_default_timeout(LIMIT_MS)
        page, said = context.new_page(), list[str]()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        try:
            page.goto(self.address.rstrip("/") + path)
            yield page
        finally:
            context.close()
        # The browser says so when its server is gone, and when that asks a gateway that is killed or answers too late.
        lost = ("net::ERR_", "status of 503")
        assert [text for text in said if not any(words in text for words in lost)] == [], said


_shared = list[Browser]()


@contextmanager
def chromium() -> Iterator[Browser]:
    """Debian's chromium, while it runs; within another use, the one that runs already."""
    if _shared:
        yield _shared[0]
        return
    assert _CHROMIUM.exists(), "chromium is missing: install Debian's chromium"
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox"]) as started,
    ):
        _shared.append(started)
        try:
            yield started
        finally:
            _shared.clear()


@contextmanager
def page_rig() -> Iterator[PageRig]:
    """A rig with a running browser."""
    with chromium() as browser, ExitStack() as stack:
        yield PageRig(browser, stack)


def open_screen(page: Page, name: str) -> None:
    """Open a screen of a machine as a person does."""
    page.click(f"#rail [data-screen={name}]")


def expect_each_part(page: Page, limit_ms: float = LIMIT_MS) -> None:
    """The page of a machine that has been learnt has data in each of its parts.

    Parameters
    ----------
    limit_ms: until the first decision and the first axis error are there
    """
    expect(page.locator("#because")).to_contain_text(re.compile(r"\d\u202fµm"), timeout=limit_ms)
    for axis in "XYZ":
        half = page.locator(f"#axes [data-axis={axis}] [data-of=half]")
        expect(half).to_have_text(re.compile(r"^\d+\.\d\u202fµm$"), timeout=limit_ms)
    expect(page.locator("#waits")).to_contain_text("compensation")
    expect(page.locator("#waits")).to_contain_text("Last measurement")
    expect(page.locator("#channels li")).to_have_count(30)
    expect(page.locator("#drives .stack")).to_have_count(9)
    expect(page.locator("#health")).to_contain_text("30 of 30 good")
    open_screen(page, "log")
    page.select_option("#event-kind", "")
    expect(page.locator("#events tbody tr")).not_to_have_count(0)
    expect(page.locator("#corrections tbody tr")).not_to_have_count(0)


def ports(n: int) -> list[int]:
    """Free ports."""
    return [free_port() for _ in range(n)]


def played_mill(rig: PageRig, settings: Path) -> ChildProgram:
    """One gateway that has published the day of the demo's machine, after the page's program listened."""
    (port,) = ports(1)
    gateway = rig.gateway(port, "mill")
    rig.serve([port], settings)
    with rig.page("/machine/mill") as page:
        expect(page.locator("#word")).to_have_text("No data yet")  # alive, and fresh
        gateway.say("")
        assert gateway.hear() == "published"
        expect(page.locator("#event-kind option")).not_to_have_count(2)
    return gateway
