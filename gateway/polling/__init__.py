"""What every part that polls something outside the gateway needs: when to ask, when to ask again, what to report."""

from gateway.polling.breaker import Breaker
from gateway.polling.periodic import Periodic
from gateway.polling.problems import Notice, Notify, Problems

__all__ = ["Breaker", "Notice", "Notify", "Periodic", "Problems"]
