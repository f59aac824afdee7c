"""A problem that began or ended, or a fact about the machine."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gateway.model.text import Text, Value


@dataclass(frozen=True, slots=True)
class Notice:
    """A problem that began or ended, or what is worth knowing and is none. Reported once each."""

    subject: str
    """What has it: `bus rtu1`, `period of bus rtu1`, `device rtd1`, `channel bed_front_left`, `NC`. It stays the same
    from its beginning to its end."""
    text: Text
    ended: bool = False
    is_fact: bool = False
    """Whether it is no problem and has no end."""
    at_s: float = field(default=0.0, compare=False)
    """On the clock of whoever reports it, monotonic seconds."""

    @property
    def code(self) -> str:
        """Of NoticeCode."""
        return self.text.code

    @property
    def values(self) -> Mapping[str, Value]:
        """By name."""
        return self.text.values


Notify = Callable[[Notice], None]
