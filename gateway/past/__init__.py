"""What an earlier run left in the store, the controller rebuilt from it, and the snapshots that the next run needs."""

from gateway.past.earlier import Past, decide_alike, from_stored, past_in, past_of, stored_config
from gateway.past.rebuild import Interrupted, Rebuilt, continued, controller_of, marks, rebuilt, start_of
from gateway.past.snapshots import SnapshotKeeper

__all__ = [
    "Interrupted",
    "Past",
    "Rebuilt",
    "SnapshotKeeper",
    "continued",
    "controller_of",
    "decide_alike",
    "from_stored",
    "marks",
    "past_in",
    "past_of",
    "rebuilt",
    "start_of",
    "stored_config",
]
