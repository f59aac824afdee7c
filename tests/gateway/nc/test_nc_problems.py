"""What is still wrong with the control, according to what a run has reported."""

import pytest

from gateway.nc.problems import (
    CONNECTED_AGAIN,
    DISARMED,
    HEARD_AGAIN,
    NOT_ANSWERED,
    NOT_CONNECTED,
    NOT_RECEIVED,
    UNRECEIVED,
    still_wrong,
)

LOST, REFUSED = f"{NOT_CONNECTED}device nc: silent", f"{NOT_CONNECTED}device nc: refused"
UNHEARD, NEVER_HEARD = NOT_RECEIVED, f"{NOT_ANSWERED}: no offset is written"
"""UNHEARD: as programs up to 2026-11 stored it."""
WRONG = f"NC: wrote offsets 1 µm but 2 are in force; {DISARMED}. Does another program write them?"


@pytest.mark.parametrize(
    ("texts", "wrong"),
    [
        ([], ()),
        ([LOST], (LOST,)),
        ([LOST, REFUSED], (REFUSED,)),
        ([LOST, CONNECTED_AGAIN], ()),
        ([LOST, UNHEARD, CONNECTED_AGAIN], (UNHEARD,)),
        ([UNRECEIVED], (UNRECEIVED,)),
        ([UNRECEIVED, HEARD_AGAIN], ()),
        ([NEVER_HEARD, UNHEARD, HEARD_AGAIN], ()),
        ([WRONG, LOST, CONNECTED_AGAIN], (WRONG,)),
        ([f"device rtd1: {DISARMED}", "NC: cycles take longer than period_s"], ()),
    ],
    ids=[
        "nothing",
        "lost",
        "for another reason",
        "and found",
        "and unheard",
        "told what to do",
        "and done",
        "heard",
        "disarmed",
        "of something else",
    ],
)
def test_what_is_not_ended_is_still_wrong(texts: list[str], wrong: tuple[str, ...]) -> None:
    assert still_wrong(texts) == wrong
