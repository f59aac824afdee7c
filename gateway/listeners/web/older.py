"""Corrections older than those that the page has received, from the gateway's store, page by page."""

import asyncio
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import msgspec
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from gateway.listeners.web.audit import ShownCorrection, correction_lines
from gateway.listeners.web.past import EARLIEST_S, LATEST_S
from gateway.listeners.web.sentences import UNHEARD, Atom, why
from gateway.listeners.web.week_pages import AskCourse
from gateway.model.text import json_text
from gateway.telemetry.subscriber.site import SiteSeen

MOST_TIMES = 40
"""At which the learner gave its reasons, of one answer."""
_FARTHEST = timedelta(days=183)
"""No answer looks further back; the next one goes on from where it ended."""
_ENCODER = msgspec.json.Encoder(enc_hook=json_text)


@dataclass(frozen=True, slots=True)
class OlderCorrections:
    """One answer."""

    lines: list[ShownCorrection]
    """The newest first."""
    before: str | None
    """Where the next answer goes on; null: nothing older is stored."""
    why: "Atom | None"
    """Why the store could not be asked; null: it was."""


class OlderPages:
    """Answers with what is stored.

    Parameters
    ----------
    site: whose machines are asked
    ask: where reasons come from; None: nowhere
    asking: held while a gateway is asked, so that one browser does not stop the others
    """

    def __init__(self, site: SiteSeen, ask: AskCourse | None, asking: asyncio.Semaphore) -> None:
        self._site, self._ask, self._asking = site, ask, asking

    async def corrections(self, request: Request) -> Response:
        """Those of before a time, `before` in the query; without it the latest."""
        name = request.path_params["name"]
        if not self._site.may_be(name):
            return PlainTextResponse("This is not a valid name of a machine.", 404)
        with self._site.machines() as machines:
            seen = machines.get(name)
            latest = None if seen is None else seen.latest
        try:
            end = _time(request.query_params["before"]) if "before" in request.query_params else latest
        except (ValueError, OverflowError) as error:
            return PlainTextResponse(f"before: {error}", 400)
        if self._ask is None or end is None:
            answer = OlderCorrections([], None, UNHEARD)
        else:
            answer = await self._older(self._ask, name, end)
        return Response(_ENCODER.encode(answer), media_type="application/json")

    async def _older(self, ask: AskCourse, name: str, end: datetime) -> OlderCorrections:
        try:
            async with self._asking:
                page = await asyncio.to_thread(ask, name, end - _FARTHEST, end, MOST_TIMES)
        except (OSError, ValueError) as error:
            return OlderCorrections([], None, why(error))
        lines = [
            line
            for each in reversed(page.reasons)
            for line in correction_lines(each.time, each.k, each.errors, each.sigma, each.measured)
        ]
        return OlderCorrections(lines, page.reasons[0].time if page.reasons else None, None)


def _time(text: str) -> datetime:
    found = datetime.fromisoformat(text).astimezone(UTC)
    if not EARLIEST_S <= found.timestamp() <= LATEST_S:
        raise ValueError(f"{text}: expected a time between 2000 and 2200")
    return found
