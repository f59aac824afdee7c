"""Errors of the operating system in its own words: libraries repeat their numbers, names and addresses in the text."""

import os
import re

from drivers.text import Text

_NUMBER = re.compile(r"\[Errno (\d+)\]|\((\d+), '")
"""An error's number in the texts of asyncio, pyserial, termios and python-can."""


def error_number(error: BaseException) -> int | None:
    """The operating system's number of the error; None: it has none."""
    return next(iter(_numbers(error)), None)


def in_words(error: BaseException) -> str:
    """What the operating system says of the error, such as `Connection refused`; else the error's own text."""
    if isinstance(error, OSError) and isinstance(error.strerror, Text):
        return error.strerror
    if numbers := _numbers(error):
        return ", ".join(dict.fromkeys(os.strerror(number) for number in numbers))
    own = error.strerror if isinstance(error, OSError) else None  # of a name that cannot be resolved
    return own or str(error) or type(error).__name__


def _numbers(error: BaseException) -> list[int]:
    """One number, or one for each address that was tried; none of an error of TLS, which are not the system's."""
    if any(base.__module__ == "ssl" for base in type(error).__mro__):
        return []
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)  # error_code: python-can's
    if isinstance(number, int) and number > 0:
        return [number]
    return [int(one or other) for one, other in _NUMBER.findall(str(error))]
