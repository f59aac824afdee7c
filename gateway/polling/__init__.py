"""The common parts of everything that polls: when to ask, when to ask again after a failure, and what to report."""

from gateway.polling.boundary import UnexpectedError, contained, uncancelled, unexpected
from gateway.polling.breaker import Breaker
from gateway.polling.periodic import Periodic
from gateway.polling.problems import Notice, Notify, Problems

__all__ = [
    "Breaker",
    "Notice",
    "Notify",
    "Periodic",
    "Problems",
    "UnexpectedError",
    "contained",
    "uncancelled",
    "unexpected",
]
