"""How a program is connected to others over the network."""

from dataclasses import dataclass
from datetime import datetime

from gateway.model.text import NOTHING, Text


@dataclass(frozen=True, slots=True)
class Connection:
    """One session's: whether it is connected, since when and to whom."""

    since: datetime
    """When this began, UTC of this computer."""
    to: str = ""
    """The places that it is connected to; empty: it only listens, or is not connected."""
    problem: Text = NOTHING
    """Why it is not connected, or not open; empty: it is."""
    confirmed: bool | None = None
    """Whether what it sends comes back from there; None: not known, or there is nowhere that it could come from."""
    other: str = ""
    """The run of another gateway of the same name that was heard; empty: none was."""

    @property
    def kind(self) -> str:
        """What `problem` and its cause are, whatever times and values they have; empty: there is none."""
        if not self.problem:
            return ""
        why = self.problem.values.get("why")
        return f"{self.problem.code} {(isinstance(why, Text) and why.code) or why}"
