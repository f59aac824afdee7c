"""What the codes of the probing handshake mean: R65 and R66, docs/nc.md."""

from typing import Final

from drivers.nc import ProbingState
from drivers.text import Text

PROBING_STATES: Final = {
    1: ProbingState.ACCEPTED,
    2: ProbingState.RUNNING,
    3: ProbingState.DONE,
    4: ProbingState.REFUSED,
    5: ProbingState.FAILED,
}
UNDER_WAY: Final = frozenset({ProbingState.ACCEPTED, ProbingState.RUNNING})
FINAL: Final = frozenset({ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED})
PROBING_REASONS: Final = {
    0: "",
    1: Text("nc_alarm_active"),
    2: Text("nc_other_tool"),
    3: Text("nc_not_auto"),
    4: "withdrawn",
    5: Text("nc_no_safe_point"),
    6: Text("nc_no_sphere"),
    7: Text("nc_stopped"),
    8: Text("nc_safe_z"),
    9: Text("nc_transformation"),
    10: Text("nc_deflected"),
    11: Text("nc_obstacle"),
    12: Text("nc_moved_by_hand"),
    13: Text("nc_not_referenced"),
    14: Text("nc_tool_unsure"),
    15: Text("nc_height_missing"),
    16: Text("nc_spindle"),
    17: Text("nc_own_dry_run"),
    18: Text("nc_beyond_travel"),
}
