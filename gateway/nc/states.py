"""The states of the link. Pure.

Those of its offsets and of its right to write them are tables. The others are the control's, and the basis of a target.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import TypeVar


class LinkState(StrEnum):
    """The state of the offsets of one control."""

    AWAY = "away"
    """There is no connection: the offsets are unknown."""
    FOLLOWING = "following"
    """Each step moves towards the target."""
    HELD = "held"
    """They do not change while the control probes, whoever requested the cycle."""
    NOT_READY = "not_ready"
    """Emergency stop, drives off or axes not referenced: they do not change, and are read again afterwards."""
    STOPPING = "stopping"
    """They ramp to the configured state, then the control is released."""


class Condition(StrEnum):
    """What a period finds; the strongest of several counts, in the order lost, not ready, probing."""

    CONNECTED = "connected"
    LOST = "lost"
    NOT_READY = "not_ready"
    PROBING = "probing"
    CLEAR = "clear"
    """The control is ready and is not probing."""
    STOP = "stop"


_CONNECTED: Mapping[Condition, LinkState] = {
    Condition.CLEAR: LinkState.FOLLOWING,
    Condition.PROBING: LinkState.HELD,
    Condition.NOT_READY: LinkState.NOT_READY,
    Condition.LOST: LinkState.AWAY,
    Condition.STOP: LinkState.STOPPING,
}
STATES: Mapping[LinkState, Mapping[Condition, LinkState]] = {
    LinkState.AWAY: {
        Condition.CONNECTED: LinkState.FOLLOWING,
        Condition.LOST: LinkState.AWAY,
        Condition.STOP: LinkState.AWAY,
    },
    LinkState.FOLLOWING: _CONNECTED,
    LinkState.HELD: _CONNECTED,
    LinkState.NOT_READY: _CONNECTED,
    LinkState.STOPPING: {Condition.STOP: LinkState.STOPPING},
}


class Right(StrEnum):
    """Whether this gateway may write offsets."""

    NONE = "none"
    """The mode is not `compensate`: no claim, no heartbeat, no write."""
    UNCLAIMED = "unclaimed"
    """There is no connection, or the control has not been claimed on it."""
    UNHEARD = "unheard"
    """Claimed, but the control's watchdog has not confirmed that it is active: nothing is written."""
    HEARD = "heard"
    """The watchdog is active: offsets may be written as long as the last heartbeat is fresh."""
    DISARMED = "disarmed"
    """Given up until a restart: no claim, no heartbeat, no write."""


class Reply(StrEnum):
    """What changes the right to write."""

    CLAIMED = "claimed"
    HEARD = "heard"
    UNHEARD = "unheard"
    LOST = "lost"
    DISARM = "disarm"


_CLAIMED: Mapping[Reply, Right] = {
    Reply.HEARD: Right.HEARD,
    Reply.UNHEARD: Right.UNHEARD,
    Reply.LOST: Right.UNCLAIMED,
    Reply.DISARM: Right.DISARMED,
}
RIGHTS: Mapping[Right, Mapping[Reply, Right]] = {
    Right.NONE: {Reply.LOST: Right.NONE},
    Right.UNCLAIMED: {Reply.CLAIMED: Right.UNHEARD, Reply.LOST: Right.UNCLAIMED},
    Right.UNHEARD: _CLAIMED,
    Right.HEARD: _CLAIMED,
    Right.DISARMED: {Reply.LOST: Right.DISARMED},
}

_S = TypeVar("_S", LinkState, Right)
_E = TypeVar("_E", Condition, Reply)


def after(table: Mapping[_S, Mapping[_E, _S]], now: _S, event: _E) -> _S:
    """The next state. Raises RuntimeError for an event that is impossible in this state."""
    try:
        return table[now][event]
    except KeyError:
        raise RuntimeError(f"{event.value!r} cannot happen in state {now.value!r}") from None
