"""Problems of a recording, collected into one error."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from gateway.config.problems import Problem
from gateway.model.given import GivenError

_SHOWN = 10
"""Number of problems that are listed; more are only counted."""
_ALIKE = 3
"""Number of those of one kind that are listed, so that others are seen too."""


class RecordingError(GivenError):
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
        self._kinds: Counter[str] = Counter()

    def add(self, where: str, what: str, kind: str = "") -> None:
        """kind: of mistakes that a file makes again and again, such as a column of text; empty: none of these."""
        self._kinds[kind] += 1
        if len(self._kept) < _SHOWN and (not kind or self._kinds[kind] <= _ALIKE):
            self._kept.append(Problem(where, what))
        else:
            self._more += 1

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self._kept)

    def refuse(self) -> None:
        """Raises RecordingError when there is any."""
        if self._kept:
            raise RecordingError(self._file, self._kept, self._more)
