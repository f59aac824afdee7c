"""Answers a browser's requests for figures by week, from what a machine's gateway has stored of the last weeks."""

import asyncio
from collections.abc import Callable
from datetime import datetime
from typing import TypeVar

import msgspec
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from gateway.listeners.web.sensitivity import MOST_ESTIMATES, SensitivityWeeks, sensitivity_by_week
from gateway.listeners.web.sentences import UNHEARD, Atom, why
from gateway.listeners.web.weeks import MOST_MEASUREMENTS, WEEKS, ScatterWeeks, scatter_by_week
from gateway.model.text import json_text
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.subscriber.site import SiteSeen

AskCourse = Callable[[str, datetime, datetime, int], CoursePage]
"""A machine's stored estimates of a span, at most as many as the last argument says. Blocks. Raises OSError."""
_Weeks = TypeVar("_Weeks", ScatterWeeks, SensitivityWeeks)
_ENCODER = msgspec.json.Encoder(enc_hook=json_text)


def unanswered(reason: Atom) -> Response:
    """Why a gateway has not answered, for a page that says it in its language."""
    return Response(_ENCODER.encode(reason), 503, media_type="application/json")


class WeekPages:
    """Answers with what is computed by week.

    Parameters
    ----------
    site: whose machines are asked
    ask: where estimates come from; None: nowhere
    ask_with_temperatures: likewise, with the temperatures at their times
    asking: held while a gateway is asked, so that one browser does not stop the others
    """

    def __init__(
        self,
        site: SiteSeen,
        ask: AskCourse | None,
        ask_with_temperatures: AskCourse | None,
        asking: asyncio.Semaphore,
    ) -> None:
        self._site, self._asking = site, asking
        self._ask, self._ask_with_temperatures = ask, ask_with_temperatures

    async def scatter(self, request: Request) -> Response:
        """How far the touches of a machine's measurements scatter."""
        return await self._answer(
            request,
            self._ask,
            MOST_MEASUREMENTS,
            lambda page: ScatterWeeks(scatter_by_week(page), None),
            lambda told: ScatterWeeks(None, told),
        )

    async def sensitivity(self, request: Request) -> Response:
        """How many micrometres a kelvin moves each error."""
        return await self._answer(
            request,
            self._ask_with_temperatures,
            MOST_ESTIMATES,
            sensitivity_by_week,
            lambda told: SensitivityWeeks(None, [], told),
        )

    async def _answer(
        self,
        request: Request,
        ask: AskCourse | None,
        most: int,
        found: Callable[[CoursePage], _Weeks],
        unknown: Callable[[Atom], _Weeks],
    ) -> Response:
        """Answer with the weeks, or with why they are unknown: that is not an HTTP error, which browsers would
        report."""
        name = request.path_params["name"]
        if not self._site.may_be(name):
            return PlainTextResponse("This is not a valid name of a machine.", 404)
        with self._site.machines() as machines:
            seen = machines.get(name)
            now = None if seen is None else seen.latest
        if ask is None or now is None:
            answer = unknown(UNHEARD)
        else:
            try:
                async with self._asking:
                    answer = await asyncio.to_thread(lambda: found(ask(name, now - WEEKS, now, most)))
            except (OSError, ValueError) as error:
                answer = unknown(why(error))
        return Response(_ENCODER.encode(answer), media_type="application/json")
