"""The control's numbers as they are read, checked."""

import math

from drivers.base import BadAnswer
from drivers.opcua.session import OpcUaNumber
from drivers.text import Text


def finite_numbers(paths: tuple[str, ...], values: list[OpcUaNumber | None], device: str) -> list[float]:
    """Raises BadAnswer, which names the node, for a value that is missing or not a finite number."""
    numbers = given_numbers(paths, values, device)
    for path, value in zip(paths, numbers, strict=True):
        if not math.isfinite(value):
            raise BadAnswer(Text("nc_not_finite", path=path, value=value), device=device)
    return numbers


def given_numbers(paths: tuple[str, ...], values: list[OpcUaNumber | None], device: str) -> list[float]:
    """Like finite_numbers, but the values may be non-finite: the caller checks the results of a cycle."""
    for path, value in zip(paths, values, strict=True):
        if value is None:
            raise BadAnswer(Text("nc_no_value", path=path), device=device)
    return [float(value) for value in values if value is not None]


def code_of(value: OpcUaNumber | None) -> int:
    """An R-parameter is a floating-point number even where it holds a code; -1 for none."""
    return -1 if value is None or not math.isfinite(value) else round(value)
