"""A stand-in for a page's session with a gateway that has a store."""

from collections.abc import Callable
from datetime import datetime

from gateway.telemetry.answers import CoursePage


class StoredElsewhere:
    """Answers queries on `course`.

    Parameters
    ----------
    answer: gives the page, or raises
    """

    def __init__(self, answer: Callable[[], CoursePage]) -> None:
        self.answer, self.asked = answer, list[tuple[str, datetime, datetime, int]]()

    def ask(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        self.asked.append((machine, begin, end, limit))
        return self.answer()

    def ask_with_temperatures(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        return self.ask(machine, begin, end, limit)

    ask_with_inputs = ask_with_temperatures

    def ask_scenario(self, *_: object) -> None:
        raise AssertionError("nobody asks for a scenario")

    def ask_reasons(self, machine: str, begin: datetime, end: datetime, limit: int) -> CoursePage:
        return self.ask(machine, begin, end, limit)

    def ask_report(self, *_: object) -> None:
        raise AssertionError("nobody asks for a report")

    def give(self, *_: object) -> None:
        raise AssertionError("nobody gives a command")
