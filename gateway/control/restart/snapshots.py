"""Takes snapshots of the running controller, so that a restart need not repeat the whole record."""

from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import EarlierRun
from gateway.control.restart.rebuild import Rebuilt, marks
from gateway.model.events import DecisionMade, FrameMade, GatewayEvent
from gateway.storage.store import Store
from talc.frame import Frame

EVERY_STEPS = 288
"""Between two snapshots: a day at 5 min. A restart repeats no more steps than this."""


class SnapshotKeeper:
    """A sink, after the store's own, that takes a snapshot of the controller every `every_steps` steps.

    Parameters
    ----------
    past: the controller, and what an earlier run left
    store: takes the snapshots
    config: that the controller runs with
    every_steps: between two snapshots
    """

    def __init__(self, past: EarlierRun, store: Store, config: GatewayConfig, every_steps: int = EVERY_STEPS) -> None:
        missing, measured = dict(past.missing), list(past.measured)
        self._known = Rebuilt(past.controller, missing=missing, measured=measured, steps=past.since_snapshot)
        self._store, self._marks, self._every = store, marks(config), every_steps
        self._frame: Frame | None = None

    def take(self, event: GatewayEvent) -> None:
        """Take an event."""
        match event:
            case FrameMade(frame):
                self._frame = frame
            case DecisionMade(decision) if self._frame is not None:
                self._known.follow(self._frame, decision)
                if (snapshot := self._known.snapshot_if_due(self._every, self._marks)) is not None:
                    self._store.keep(snapshot)
            case _:
                pass
