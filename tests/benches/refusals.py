"""What a refusal says, whatever its words: code, field and values."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, TypeVar

import pytest

from drivers.base import DriverError, dotted
from drivers.text import Text, Value, text_of

E = TypeVar("E", bound=BaseException)
_WHERE: Final = ("file_problem", "problems", "at_place", "at_field", "place_problem", "in_file", "with_hint", "several")
"""Codes that only join others."""


def coded(said: BaseException | str) -> str:
    """`at_most(limit=5)`, with the texts in it in the same form; words of others in quotes."""
    text = text_of(said) if isinstance(said, BaseException) else said
    if not isinstance(text, Text) or not text.code:
        return repr(str(text))
    return f"{text.code}({', '.join(f'{name}={_written(value)}' for name, value in text.values.items())})"


def _written(value: Value) -> str:
    if isinstance(value, str):
        return coded(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_written(each) for each in value)}]"
    return repr(value)


@contextmanager
def refusing(kind: type[E], said: str) -> Iterator[pytest.ExceptionInfo[E]]:
    """What is done within raises such an error, whose `summary` has this field, these codes and, among others, these
    values."""
    with pytest.raises(kind) as raised:
        yield raised
    wanted = said.split()
    assert [each for each in summary(raised.value).split() if "=" not in each or each in wanted] == wanted


def summary(error: BaseException) -> str:
    """`baud: expected value=299 at_least limit=300`: the field, if there is one, and codes with their values."""
    whole = getattr(error, "text", None)  # of a file
    said = " ".join(_said(whole if isinstance(whole, Text) else text_of(error)))
    at = [problem.place for problem in getattr(error, "problems", ())] or [_field(error)]
    return f"{', '.join(at)}: {said}" if any(at) else said


def _field(error: BaseException) -> str:
    if isinstance(error, DriverError) and error.field:
        return dotted(error.field)
    field = text_of(error).value_of("field")
    return "" if field is None else str(field)


def _said(text: Text) -> Iterator[str]:
    if text.code and text.code not in _WHERE:
        yield text.code
    for name, value in text.values.items():
        texts = [each for each in (value if isinstance(value, list | tuple) else [value]) if isinstance(each, Text)]
        if name != "where" and any(each.code for each in texts):
            for each in texts:
                yield from _said(each)
        elif text.code not in _WHERE:
            yield f"{name}={value}".replace(" ", "_")
