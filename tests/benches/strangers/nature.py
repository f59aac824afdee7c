"""What drawn devices of all kinds share: how their nature is told, and what one of their trials shows."""

import random
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any, ClassVar, Protocol


class Told:
    """A frozen dataclass as one line: what it always tells, and what is not as by default."""

    always: ClassVar[Sequence[str]] = ("period_s", "timeout_s")

    def __str__(self) -> str:
        # Whoever derives from this is a dataclass.
        return ", ".join(
            f"{f.name} {value:.3g}" if isinstance(value, float) else f"{f.name} {value}"
            for f in fields(self)  # type: ignore[arg-type]
            if (value := getattr(self, f.name)) != f.default or f.name in self.always
        )


class Trial(Protocol):
    """Of one device."""

    nature: Any
    said: Any
    notices: Any
    ours: Any
    """A Polled."""
    plain: Any
    """What a plain client has read."""

    def problems(self) -> Iterable[str]:
        """What was not read as it must be."""


def log_uniform(draw: random.Random, low: float, high: float) -> float:
    return float(low * (high / low) ** draw.random())


def shown(trial: Trial) -> dict[str, object]:
    """All of one trial, to look at."""
    return {
        "nature": str(trial.nature),
        "problems": list(trial.problems()),
        "said": trial.said,
        "notices": trial.notices,
        "good": {channel: len(times) for channel, times in trial.ours.good.items()},
        "plain": trial.plain,
    }
