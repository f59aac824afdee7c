"""Arguments of the commands, checked. Each function raises Refusal."""

import math
from typing import Any

from talc_server import Refusal

COUNTS = {3: "three", 9: "nine"}


def number(value: object, name: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
    except OverflowError:  # JSON's integers may be longer than any float
        pass
    raise Refusal(f"{name} = {value!r}: expected a finite number")


def numbers(command: dict[str, Any], name: str, count: int) -> list[float]:
    values = command.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise Refusal(f"{name}: expected a list of {COUNTS[count]} numbers")
    return [number(v, name) for v in values]


def positive(command: dict[str, Any], name: str) -> float:
    value = number(command.get(name), name)
    if not value > 0:
        raise Refusal(f"{name} = {value:g}: expected more than 0")
    return value


def not_negative(command: dict[str, Any], name: str, default: float | None = None) -> float:
    value = number(command.get(name, default), name)
    if value < 0:
        raise Refusal(f"{name} = {value:g}: expected 0 or more")
    return value


def whole(command: dict[str, Any], name: str) -> int:
    value = command.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 2**31:
        raise Refusal(f"{name} = {value!r}: expected 1 to 2147483647")
    return value
