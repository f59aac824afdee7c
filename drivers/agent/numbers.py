"""Numbers, lists and tables in an agent's answers. Raises BadAnswer."""

import math
from contextlib import suppress

from drivers.agent.connection import Json
from drivers.base import BadAnswer
from drivers.text import Text

_HINT = Text("agent_version_differs")


def json_object(answer: Json, what: str, device: str) -> dict[str, Json]:
    """An object."""
    if not isinstance(answer, dict):
        raise BadAnswer(Text("agent_no_object", what=what), device=device, hint=_HINT)
    return answer


def finite_number(value: Json, what: str, device: str) -> float:
    """A finite number; a truth value is not a number."""
    with suppress(OverflowError):  # JSON's integers may be longer than any float
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
    raise BadAnswer(Text("agent_no_number", what=what, value=repr(value)), device=device, hint=_HINT)


def finite_numbers(value: Json, count: int, what: str, device: str) -> tuple[float, ...]:
    """A list of `count` finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise BadAnswer(Text("agent_numbers", what=what, value=repr(value), count=count), device=device, hint=_HINT)
    return tuple(finite_number(v, what, device) for v in value)


def triple(value: Json, what: str, device: str) -> tuple[float, float, float]:
    """X, Y, Z."""
    x, y, z = finite_numbers(value, 3, what, device)
    return x, y, z
