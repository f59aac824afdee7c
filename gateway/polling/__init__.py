"""The common parts of everything that polls: when to ask, when to ask again after a failure, and what to report."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.polling.boundary import UnexpectedError, contained, uncancelled, unexpected
    from gateway.polling.breaker import Breaker
    from gateway.polling.periodic import Periodic
    from gateway.polling.problems import Problems, TurnTime
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".boundary": ("UnexpectedError", "contained", "uncancelled", "unexpected"),
            ".breaker": ("Breaker",),
            ".periodic": ("Periodic",),
            ".problems": ("Problems", "TurnTime"),
        },
    )

__all__ = [
    "Breaker",
    "Periodic",
    "Problems",
    "TurnTime",
    "UnexpectedError",
    "contained",
    "uncancelled",
    "unexpected",
]
