"""The next two hours as they are and under a load: the largest error at the tool, as curves."""

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from drivers.base import SetupError
from gateway.listeners.web.ahead import WARM_S, AheadError, Outlook, ahead, ahead_along, outlook, planned_ahead
from gateway.listeners.web.at_tool import ToolError
from gateway.listeners.web.sentences import UNHEARD, Atom, Sentence, ToldName, Word, at, lasting, um, why
from gateway.listeners.web.verdict import Viewpoint, tool_now
from gateway.listeners.web.week_pages import unanswered
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.scenario_queries import USUAL_MIN, minutes_of
from gateway.telemetry.subscriber.instants import instant
from gateway.telemetry.subscriber.machine import MachineSeen
from gateway.telemetry.subscriber.site import SiteSeen

AskScenario = Callable[[str, str, int], ScenarioPage]
"""A machine's errors under a load for so many minutes. Blocks. Raises OSError."""
_ENCODER = msgspec.json.Encoder()
_MOST_LETTERS = 40


@dataclass(frozen=True, slots=True)
class ShownBranch:
    """The largest error of the three axes from now on, µm; null: not known."""

    load: str
    """Name of a planned load; empty: as it is now."""
    began: float
    """When now is, UTC seconds."""
    t: list[float]
    """Seconds from now."""
    high: list[float | None]
    """The most that the far end of the interval will be."""
    turn: float | None = None
    """Seconds from now when the whole interval comes within the tolerance, or no longer is."""


@dataclass(frozen=True, slots=True)
class ShownScenario:
    """What a browser is sent."""

    branches: list[ShownBranch]
    said: list[Sentence] = field(default_factory=list)


def branches(seen: MachineSeen, viewpoint: Viewpoint, error: ToolError | None) -> list[ShownBranch]:
    """As it is, and under each planned load, by the published forecast. error: at the tool now"""
    coming = ahead(seen, viewpoint.matrix) if seen.present else None
    if coming is None or error is None or not np.isfinite(error.far).all():
        return []
    loads = planned_ahead(seen, viewpoint.matrix)
    every = [("", coming), *((name, each) for name, each in loads.items() if each)]
    return [_branch(name, error, each, viewpoint.tolerance_um) for name, each in every]


def _branch(load: str, now: ToolError, coming: AheadError, tolerance_um: float | None) -> ShownBranch:
    near = np.array(coming.seconds) <= WARM_S
    first = float(np.max(now.far))
    largest = np.max(coming.high[near], axis=1).tolist()  # NaN where an axis is not known
    high = [round(first, 2), *(round(v, 2) if np.isfinite(v) else None for v in largest)]
    seconds = [0.0, *np.array(coming.seconds)[near].tolist()]
    seen = None if tolerance_um is None else outlook(now, coming)
    turn = None if seen is None or tolerance_um is None else seen.turn(tolerance_um)
    after = None if seen is None or turn is None else (turn - seen.at[0]).total_seconds()
    began = coming.at[0].timestamp() - coming.seconds[0]
    return ShownBranch(load, began, seconds, high, after)


def shown_scenario(
    seen: MachineSeen, page: ScenarioPage, viewpoint: Viewpoint, now_s: float, load: str = ""
) -> ShownScenario:
    """A scenario at the chosen point, and what it says. Raises ValueError for columns of different lengths.

    load: name of the planned load; empty: of the spindle, as it usually is
    """
    error, made = tool_now(seen, viewpoint.matrix, now_s).error, instant(page.time)
    values: dict[str, Atom] = {
        "load": ToldName(load) if load else Word("scenario.spindle"),
        "lasts": lasting(60.0 * page.minutes),
    }
    if not page.loads:
        return ShownScenario([], [Sentence("scenario.no_load")])
    if error is None or seen.forecast is None or made is None or not np.isfinite(error.far).all():
        return ShownScenario([], [Sentence("scenario.no_forecast")])
    stays = ahead_along(seen, page, page.stays, viewpoint.matrix)
    if not page.loaded:
        return ShownScenario(
            [_branch("", error, stays, viewpoint.tolerance_um)], [Sentence("scenario.unknown", values)]
        )
    run = ahead_along(seen, page, page.loaded, viewpoint.matrix)
    coming = ahead(seen, viewpoint.matrix)
    usual = None if coming is None else outlook(error, coming)
    said = list(_said(values, error, stays, run, usual, viewpoint.tolerance_um))
    both = [_branch(name, error, each, viewpoint.tolerance_um) for name, each in (("", stays), ("?", run))]
    return ShownScenario(both, said)


def _said(
    values: dict[str, Atom],
    now: ToolError,
    stays: AheadError,
    run: AheadError,
    usual: Outlook | None,
    tolerance_um: float | None,
) -> Iterator[Sentence]:
    """When the whole interval is within the tolerance, and when it would be as it is now, by `usual`; else how much
    less is left in the end."""
    seen = outlook(now, run)
    if seen is None:
        yield Sentence("scenario.not_checked", values)
        return
    last = len(seen.at) - 2  # of the forecast, which does not begin with now
    as_now = float(np.max(stays.far[last]))
    gain = as_now - float(np.max(run.far[last]))
    ended: dict[str, Atom] = values | {"at": at(seen.at[-1]), "far": um(float(seen.high[-1])), "gain": um(abs(gain))}
    already = tolerance_um is not None and bool(np.max(now.far) <= tolerance_um)
    turn = None if tolerance_um is None else seen.turn(tolerance_um)
    if turn is not None:
        key, otherwise = "scenario.leaves" if already else "scenario.ready", None
        if usual is not None and tolerance_um is not None:
            otherwise = usual.turn(tolerance_um)
        instead = ToldName("") if otherwise is None else Sentence("scenario.instead", {"at": at(otherwise)})
        yield Sentence(key, values | {"at": at(turn), "instead": instead})
    elif already:
        yield Sentence("scenario.stays", ended)
    else:
        yield Sentence("scenario.better" if gain > 0.0 else "scenario.worse", ended)


class ScenarioPages:
    """Answers with scenarios.

    Parameters
    ----------
    site: whose machines are asked
    ask: where scenarios come from; None: nowhere
    viewpoint_of: how a browser's query looks at each machine; raises SetupError
    """

    def __init__(
        self,
        site: SiteSeen,
        ask: AskScenario | None,
        viewpoint_of: Callable[[Mapping[str, str]], Callable[[MachineSeen], Viewpoint]],
    ) -> None:
        self._site, self._ask, self._viewpoint_of = site, ask, viewpoint_of
        self._asking = asyncio.Semaphore(1)

    async def scenario(self, request: Request) -> Response:
        """The machine's next two hours under `load`, for `minutes`."""
        name, query = request.path_params["name"], request.query_params
        load = query.get("load", "")
        if not self._site.may_be(name):
            return PlainTextResponse("This is not a valid name of a machine.", 404)
        try:
            viewpoint_of = self._viewpoint_of(query)
            minutes = minutes_of(query.get("minutes", USUAL_MIN))
        except (SetupError, ValueError) as error:
            return PlainTextResponse(str(error), 400)
        if len(load) > _MOST_LETTERS or set(load) & set(";?#"):
            return PlainTextResponse("load: expected the name of a planned load", 400)
        if self._ask is None:
            return unanswered(UNHEARD)
        try:
            async with self._asking:
                page = await asyncio.to_thread(self._ask, name, load, minutes)
            with self._site.machines() as machines:
                seen = machines.get(name) or MachineSeen(name)
                shown = shown_scenario(seen, page, viewpoint_of(seen), self._site.now_s(), load)
        except (OSError, ValueError) as error:
            return unanswered(why(error))
        return Response(_ENCODER.encode(shown), media_type="application/json")
