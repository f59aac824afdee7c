"""Problems of a recording, collected into one error."""

from collections.abc import Sequence
from pathlib import Path

from gateway.config import Problem

_SHOWN = 10
"""Number of problems that are listed; more are only counted."""


class RecordingError(Exception):
    """The recording cannot be used. The text has one line per problem, each beginning with the file's name."""

    def __init__(self, file: Path, problems: Sequence[Problem], more: int = 0) -> None:
        lines = [f"{file}: {problem}" for problem in problems]
        if more:
            lines.append(f"{file}: and {more} more")
        super().__init__("\n".join(lines))


class FileProblems:
    """The problems of one file: the first ones are kept, the others counted."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._kept: list[Problem] = []
        self._more = 0

    def add(self, where: str, what: str) -> None:
        if len(self._kept) < _SHOWN:
            self._kept.append(Problem(where, what))
        else:
            self._more += 1

    def refuse(self) -> None:
        """Raises RecordingError when there is any."""
        if self._kept:
            raise RecordingError(self._file, self._kept, self._more)
