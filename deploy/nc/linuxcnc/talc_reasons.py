"""Why there is no cycle, or no result of one: words for people, and a code for programs."""


class Reason(str):
    """What people read. code: the same whatever the words are; empty: nothing stands against it."""

    code: str

    def __new__(cls, code: str = "", text: str = "") -> "Reason":
        reason = super().__new__(cls, text)
        reason.code = code
        return reason


NONE = Reason()
OFF = Reason("not_ready", "the machine is off or not homed")
FOREIGN = Reason("foreign", "somebody else moved the machine or changed its modes")
OTHER_MODE = Reason("other_mode", "somebody changed the operating mode")
NOT_ALLOWED_ANY_MORE = Reason("may_start_ended", "the pin talc.may-start became FALSE")
NOT_ALLOWED = Reason("may_start", "no program runs, and the pin talc.may-start is FALSE")
HALTED = Reason(
    "halted", "somebody or something has stopped a cycle: look, then let the pin talc.may-start be FALSE and TRUE again"
)
BY_HAND = Reason("moved_by_hand", "the machine is being moved by hand")
PROBE_IS_LOW = Reason(
    "probe_is_low", "the touch probe is in the spindle below SAFE_Z: take it up with o<talc_retract> call"
)
EXTERNAL = Reason("external_offset", "an external offset is in force (axis.*.eoffset)")
WITHDRAWN = Reason("withdrawn", "withdrawn")
STOPPED = Reason("stopped", "the program was stopped")
INTERPRETER = Reason("interpreter", "LinuxCNC's interpreter has ended the program with an error, see its messages")
EXPIRED = Reason("expired", "no safe point before the request expired")
NOT_STARTED = Reason("not_started", "the program did not start")
OF_PROGRAM = {
    0: NONE,
    2: Reason("probe_silent", "the touch probe is missing, does not answer, or its contact is closed"),
    3: Reason("kinematics", "the kinematics are not the identity"),
    4: WITHDRAWN,
    5: EXTERNAL,
    6: Reason("no_sphere", "a touch found no sphere"),
    20: Reason("contact", "a touch where none may be"),
    21: FOREIGN,
    22: Reason("probe_failed", "the touch probe does not answer"),
    23: Reason("agent_silent", "the agent did not answer"),
    24: NOT_ALLOWED_ANY_MORE,
}
"""By the number that talc_safe_point.ngc gives."""


def of_program(number: int) -> Reason:
    return OF_PROGRAM.get(number, Reason(f"program_{number}", f"reason {number}"))
