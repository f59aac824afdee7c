"""The report of a day, as a machine's gateway makes it, in a page that can do nothing."""

import asyncio
import gzip
import io
import re
import zlib
from collections.abc import Callable
from datetime import date
from typing import Final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from drivers.base import SetupError
from gateway.listeners.web.catalogue import chosen_language
from gateway.listeners.web.past import asked_tolerance_um
from gateway.model.text import Language, text_of
from gateway.telemetry.answers import ReportPage
from gateway.telemetry.subscriber.site import SiteSeen

AskReport = Callable[[str, date, str, str, float | None], ReportPage]
"""Asks for the report of a machine, a local day, its time zone, a language and a tolerance. Blocks. Raises OSError."""
_POLICY: Final = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The report has its scripts within. The sandbox gives it its own origin: it reaches neither this server with the
user's password nor any other, and it loads nothing."""
_MOST_BYTES = 4_000_000
"""A report has at most 3 MB; a gateway of another program could send anything."""
_ASKED_AT_ONCE = 2
_ZONE = re.compile(r"[A-Za-z0-9_+/-]{0,64}")


class DayReportPages:
    """Answers with reports.

    Parameters
    ----------
    site: whose machines have reports
    ask: where reports come from; None: nowhere
    """

    def __init__(self, site: SiteSeen, ask: AskReport | None) -> None:
        self._site, self._ask = site, ask
        self._asking = asyncio.Semaphore(_ASKED_AT_ONCE)

    async def report(self, request: Request) -> Response:
        """The report of the day in the address, in the time zone, the language and the tolerance of the query."""
        name, zone = request.path_params["name"], request.query_params.get("zone", "")
        language = chosen_language(request.query_params.get("lang"), request.headers.get("accept-language", ""))
        try:
            day = date.fromisoformat(request.path_params["day"])
        except ValueError:
            return PlainTextResponse("This is not a day; expected one such as 2026-03-02.", 404)
        try:
            tolerance_um = asked_tolerance_um(request.query_params)
        except SetupError as error:
            return PlainTextResponse(text_of(error).in_language(language), 404)
        if not self._site.may_be(name) or not _ZONE.fullmatch(zone):
            return PlainTextResponse("This is not a valid name of a machine or of a time zone.", 404)
        if self._ask is None:
            return PlainTextResponse(Language(language)("page.nothing_heard"), 503)
        try:
            async with self._asking:  # somebody who opens many does not stop the others
                found = await asyncio.to_thread(self._ask, name, day, zone, language, tolerance_um)
            page = await asyncio.to_thread(_expanded, found.page)
        except OSError as error:
            said = Language(language)
            return PlainTextResponse(said("day_report.none", day=f"{day}", name=name, error=text_of(error)), 503)
        return Response(page, media_type="text/html", headers={"content-security-policy": _POLICY})


def _expanded(page: bytes) -> bytes:
    """The HTML. Raises OSError if it is not compressed, or too large."""
    try:
        with gzip.open(io.BytesIO(page)) as file:
            found = file.read(_MOST_BYTES + 1)
    except (EOFError, OSError, zlib.error) as error:
        raise OSError(f"the answer is not a page: {error}") from error
    if len(found) > _MOST_BYTES:
        raise OSError(f"the page has more than {_MOST_BYTES / 1e6:g} MB")
    return found
