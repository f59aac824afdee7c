"""What the codes of the probing handshake mean: R65 and R66, docs/nc.md."""

from typing import Final

from drivers.nc import ProbingState

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
    1: "an alarm is active",
    2: "another tool than the touch probe is in the spindle",
    3: "the control is not in AUTO",
    4: "withdrawn",
    5: "no safe point before the request expired",
    6: "a touch found no sphere",
    7: "the program was stopped",
    8: "TALC_SAFE_Z on the control is lower than the sphere at one of the poses",
    9: "a transformation, an orientable tool carrier or the control's own dry run is active",
    10: "the touch probe is deflected where it touches nothing",
    11: "the probe met something on its way to the sphere",
    12: "the axes were moved by hand within the cycle",
    13: "an axis is not referenced",
    14: "the control does not know for sure which tool is in the spindle, or whose offset is in force",
    15: "the height of a dry run (R63) is missing, or so little that its touches would meet the sphere",
    16: "the spindle is on: call TALC_SAFE_POINT where it stands",
}
