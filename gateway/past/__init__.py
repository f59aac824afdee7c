"""State that an earlier run left in the store, the controller rebuilt from it, and snapshots for the next run."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.past.earlier import Past, decide_alike, from_stored, past_in, past_of, stored_config
    from gateway.past.proven import dry_run_wanted, proven_in
    from gateway.past.rebuild import Interrupted, Rebuilt, continued, controller_of, marks, rebuilt, start_of
    from gateway.past.snapshots import SnapshotKeeper
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".earlier": ("Past", "decide_alike", "from_stored", "past_in", "past_of", "stored_config"),
            ".proven": ("dry_run_wanted", "proven_in"),
            ".rebuild": ("Interrupted", "Rebuilt", "continued", "controller_of", "marks", "rebuilt", "start_of"),
            ".snapshots": ("SnapshotKeeper",),
        },
    )

__all__ = [
    "Interrupted",
    "Past",
    "Rebuilt",
    "SnapshotKeeper",
    "continued",
    "controller_of",
    "decide_alike",
    "dry_run_wanted",
    "from_stored",
    "marks",
    "past_in",
    "past_of",
    "proven_in",
    "rebuilt",
    "start_of",
    "stored_config",
]
