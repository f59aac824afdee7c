"""The pages and their streams, as an ASGI application."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import ExitStack, asynccontextmanager, suppress
from datetime import datetime
from importlib.resources import files

import msgspec
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route

from drivers.base import SetupError
from gateway.config.certificates import certificate_end
from gateway.listeners.web.access import Guard
from gateway.listeners.web.at_tool import WorkPoint
from gateway.listeners.web.catalogue import chosen_language, page_texts
from gateway.listeners.web.commands import GivePageCommand, PageCommands
from gateway.listeners.web.day_report import DayReportPages
from gateway.listeners.web.older import OlderPages
from gateway.listeners.web.page_files import PageFiles
from gateway.listeners.web.past import MOST_POINTS, asked_number, asked_tolerance_um, shown_past, span
from gateway.listeners.web.scenario import ScenarioPages
from gateway.listeners.web.sentences import UNHEARD, why
from gateway.listeners.web.settings import MachineUse, WebSettings
from gateway.listeners.web.streams import Browser, Streams
from gateway.listeners.web.verdict import Viewpoint
from gateway.listeners.web.week_pages import AskCourse, WeekPages, unanswered
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, languages
from gateway.runtime.listening import Peer
from gateway.telemetry.subscriber.machine import MachineSeen
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription

log = logging.getLogger(__name__)

_ASKED_AT_ONCE = 2
_UNBUFFERED = {"x-accel-buffering": "no"}
"""nginx, and others that follow it, would hold back a stream until it has filled a buffer."""
_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(dict[str, dict[str, str]])
_FARTHEST_MM = 10_000.0


def _template(name: str) -> str:
    return files("gateway.listeners.web").joinpath("templates", name).read_text(encoding="utf-8")


_TEMPLATES = Environment(autoescape=True, undefined=StrictUndefined, loader=FunctionLoader(_template))


def build_app(
    site: SiteSeen,
    settings: WebSettings,
    subscription: SiteSubscription | None = None,
    uses: Mapping[str, MachineUse] | None = None,
    give: GivePageCommand | None = None,
    known: Callable[[Peer], None] = lambda _: None,
) -> Starlette:
    """The application.

    subscription: entered while it serves; None: somebody else feeds the site
    uses: of machines whose configuration is known; the settings' come before them
    give: passes commands on; None: the subscription does
    known: told the peer of each request that is let in

    Raises SetupError for a key under [operators] that cannot be used.
    """
    own_end = None if settings.tls is None else certificate_end(settings.tls.certificate)
    commands = PageCommands(settings, give or (None if subscription is None else subscription.give))
    ask = None if subscription is None else subscription.ask
    ask_with_temperatures = None if subscription is None else subscription.ask_with_temperatures
    asking = asyncio.Semaphore(_ASKED_AT_ONCE)  # a browser that zooms does not stop the others
    own = PageFiles()
    declared = {**(uses or {}), **settings.machines}
    ask_with_inputs = None if subscription is None else subscription.ask_with_inputs
    pages = _Pages(site, declared, ask, ask_with_inputs, commands, own_end, asking, own.folder)
    weeks = WeekPages(site, ask, ask_with_temperatures, asking)
    older = OlderPages(site, None if subscription is None else subscription.ask_reasons, asking)
    reports = DayReportPages(site, None if subscription is None else subscription.ask_report)
    ask_scenario = None if subscription is None else subscription.ask_scenario
    scenarios = ScenarioPages(site, ask_scenario, lambda query: _viewpoint_of(query, declared))

    @asynccontextmanager
    async def serving(_: Starlette) -> AsyncIterator[None]:
        with ExitStack() as stack:
            if subscription is not None:
                await asyncio.to_thread(stack.enter_context, subscription)
            sending = asyncio.create_task(pages.streams.run(), name="streams")
            sending.add_done_callback(_report)
            try:
                yield
            finally:
                sending.cancel()
                with suppress(asyncio.CancelledError):
                    await sending
                await asyncio.to_thread(stack.close)

    packed = [Middleware(GZipMiddleware, compresslevel=4)]  # not of pages: these hold a secret
    routes = [
        Route("/", pages.first),
        Route("/machine/{name}", pages.machine),
        Route("/machine/{name}/report/{day}", reports.report),
        Route("/file/{version}/{name}", own.file),
        Route("/past/{name}", pages.past, middleware=packed),
        Route("/scenario/{name}", scenarios.scenario),
        Route("/corrections/{name}", older.corrections, middleware=packed),
        Route("/scatter/{name}", weeks.scatter),
        Route("/sensitivity/{name}", weeks.sensitivity),
        Route("/command/{name}/{command}", pages.command, methods=["POST"]),
        Route("/stream", pages.stream),
        Route("/stream/{name}", pages.stream),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, settings=settings, known=known)], lifespan=serving)


class _Pages:
    """What is answered at each address."""

    def __init__(
        self,
        site: SiteSeen,
        uses: Mapping[str, MachineUse],
        ask: AskCourse | None,
        ask_with_inputs: AskCourse | None,
        commands: PageCommands,
        own_end: datetime | None,
        asking: asyncio.Semaphore,
        folder: str,
    ) -> None:
        self._site, self._uses, self._ask, self._commands = site, uses, ask, commands
        self._ask_with_inputs = ask_with_inputs
        self._asking, self._files = asking, folder
        self.streams = Streams(site, own_end)

    async def first(self, request: Request) -> Response:
        """The list of machines, or the page of the machine if there is only one."""
        with self._site.machines() as machines:
            only = next(iter(machines)) if len(machines) == 1 else None
        if only is not None and "all" not in request.query_params:
            language = request.query_params.get("lang")
            return RedirectResponse(f"/machine/{only}" + (f"?lang={language}" if language in languages() else ""), 303)
        return self._page(request, "list.html", "")

    async def machine(self, request: Request) -> Response:
        """The page of one machine, also of one that is heard of later: a panel starts before its gateway does."""
        name = request.path_params["name"]
        return self._page(request, "machine.html", name) if self._site.may_be(name) else _no_machine()

    async def stream(self, request: Request) -> Response:
        """Server-sent events of one machine, or of the list."""
        name = request.path_params.get("name")
        if name is not None and not self._site.may_be(name):
            return _no_machine()
        try:
            viewpoint = _viewpoint_of(request.query_params, self._uses)
        except SetupError as error:
            return PlainTextResponse(str(error), 400)
        browser = Browser(name, viewpoint)
        messages = self.streams.refusal() if self.streams.full else self.streams.messages(browser)
        return StreamingResponse(messages, media_type="text/event-stream", headers=_UNBUFFERED)

    async def past(self, request: Request) -> Response:
        """What a machine's gateway has stored of a span of time, at the chosen point."""
        name = request.path_params["name"]
        if not self._site.may_be(name):
            return _no_machine()
        try:
            viewpoint_of = _viewpoint_of(request.query_params, self._uses)
            begin, end = span(request.query_params.get("from", ""), request.query_params.get("to", ""))
        except (SetupError, ValueError) as error:
            return PlainTextResponse(str(error), 400)
        ask = self._ask_with_inputs if "temperatures" in request.query_params else self._ask
        if ask is None:
            return unanswered(UNHEARD)
        try:
            async with self._asking:
                page = await asyncio.to_thread(ask, name, begin, end, MOST_POINTS)
            with self._site.machines() as machines:
                viewpoint = viewpoint_of(machines.get(name) or MachineSeen(name))
            shown = shown_past(page, viewpoint.matrix, by_error="errors" in request.query_params)
        except (OSError, ValueError) as error:
            return unanswered(why(error))
        return Response(_ENCODER.encode(shown), media_type="application/json")

    async def command(self, request: Request) -> Response:
        """A command to a machine's gateway, and its answer."""
        name = request.path_params["name"]
        return await self._commands.answer(request, name) if self._site.may_be(name) else _no_machine()

    def _page(self, request: Request, template: str, machine: str) -> HTMLResponse:
        language = chosen_language(request.query_params.get("lang"), request.headers.get("accept-language", ""))
        html = _TEMPLATES.get_template(template).render(
            machine=machine,
            first=self._first(machine or None),
            language=language,
            languages=languages(),
            t=page_texts(language),
            use=self._uses.get(machine, MachineUse()),
            declared=machine in self._uses,
            token=self._commands.token(request),
            files=self._files,
        )
        return HTMLResponse(html)

    def _first(self, machine: str | None) -> Markup | None:
        """The state that the page draws at once, for a browser in which no tolerance or point was set; JSON.

        None: no page is served that could go on from there.
        """
        if self.streams.full:
            return None
        shown = self.streams.first(Browser(machine, _viewpoint_of({}, self._uses)))
        return Markup(shown.replace(b"<", b"\\u003c").decode())  # nothing in it ends the element


def _report(ended: asyncio.Task[None]) -> None:
    if not ended.cancelled() and (error := ended.exception()) is not None:
        log.error("the pages no longer receive anything; restart the program", exc_info=error)


def _no_machine() -> Response:
    return PlainTextResponse("This is not a valid name of a machine.", 404)


def _viewpoint_of(query: Mapping[str, str], known: Mapping[str, MachineUse]) -> Callable[[MachineSeen], Viewpoint]:
    """Of a machine: what the browser asks for, else what its gateway publishes or is declared. Raises SetupError.

    In the query, of the machine of the page; of the list, `asked` has the same by machine, in JSON.
    """
    try:
        of_each = _DECODER.decode(query.get("asked") or "{}")
    except msgspec.MsgspecError as error:
        raise SetupError(Text(NoticeCode.ASKED_WRONG, error=str(error))) from None
    asked_of = {name: _asked(values) for name, values in of_each.items()}
    others = _asked(query)
    made: dict[str, tuple[tuple[float, float], Viewpoint]] = {}

    def viewpoint(seen: MachineSeen) -> Viewpoint:
        use, asked = known.get(seen.machine, MachineUse()), asked_of.get(seen.machine, others)
        sphere = seen.sphere_mm or (use.sphere_radius_mm, use.sphere_height_mm)
        if seen.machine not in made or made[seen.machine][0] != sphere:
            default = {"x": sphere[0], "z": sphere[1]}
            place = {n: default.get(n, 0.0) if (v := asked[n]) is None else v for n in ("x", "y", "z", "a", "c")}
            tolerance = use.tolerance_um if asked["tolerance"] is None else asked["tolerance"]
            made[seen.machine] = sphere, Viewpoint(WorkPoint(**place).matrix(sphere[0] * 1e-3), tolerance)
        return made[seen.machine][1]

    return viewpoint


def _asked(query: Mapping[str, str]) -> dict[str, float | None]:
    place = {name: asked_number(query, name, -_FARTHEST_MM, _FARTHEST_MM) for name in ("x", "y", "z", "a", "c")}
    return place | {"tolerance": asked_tolerance_um(query)}
