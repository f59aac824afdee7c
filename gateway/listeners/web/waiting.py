"""Works out how much the interval at the tool grows while the next measurement is waited for."""

from collections.abc import Iterator

import numpy as np

from gateway.listeners.web.ahead import WARM_S, ahead, cycle_takes, measures
from gateway.listeners.web.sentences import Atom, SaidRow, Sentence, Word, at, um
from gateway.listeners.web.verdict import tool_now
from gateway.telemetry.subscriber.machine import MachineSeen
from talc.frame import FloatArray


def cost_of_waiting(seen: MachineSeen, matrix: FloatArray, now_s: float) -> Iterator[SaidRow]:
    """At one place, in the axis in which a measurement now would gain most: the interval when the next measurement is
    expected, or after two hours if none is; and what it would then be if the machine had been measured now."""
    error, coming = tool_now(seen, matrix, now_s).error, ahead(seen, matrix)
    if error is None or coming is None or not measures(seen):
        return
    expected = None if seen.reasons is None else seen.at_k(seen.reasons.next_k)
    made, seconds = coming.at[0].timestamp() - coming.seconds[0], np.array(coming.seconds)
    wanted = WARM_S if expected is None else expected.timestamp() - made
    then = int(np.argmin(np.abs(seconds - wanted)))
    gained = coming.waiting_half[then] - coming.measured_half[then]
    known = np.isfinite(gained) & np.isfinite(error.half)
    if not known.any():
        return
    worst = int(np.argmax(np.where(known, gained, -np.inf)))
    values: dict[str, Atom] = {
        "axis": Word("XYZ"[worst]),
        "at": at(coming.at[then]),
        "now": um(float(error.half[worst])),
        "then": um(float(coming.waiting_half[then, worst])),
        "measured": um(float(coming.measured_half[then, worst])),
        "lasts": cycle_takes(seen),
    }
    yield SaidRow("label.waiting", Sentence("waiting.cost", values))
