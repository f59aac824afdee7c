"""What is still wrong with the control, according to what a run has reported."""

import pytest

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, plain
from gateway.nc.problems import still_wrong

LOST = Text(NoticeCode.NC_NOT_CONNECTED, error="device nc: silent")
REFUSED = Text(NoticeCode.NC_NOT_CONNECTED, error="device nc: refused")
FOUND = Text(NoticeCode.NC_CONNECTED_AGAIN)
UNHEARD, NEVER_HEARD = Text(NoticeCode.NC_WATCHDOG_UNHEARD), Text(NoticeCode.NC_WATCHDOG_SILENT)
HEARD = Text(NoticeCode.NC_WATCHDOG_HEARD)
WRONG = Text(NoticeCode.NC_OTHER_OFFSETS, wanted="1", found="2")
COMES_AND_GOES = Text(NoticeCode.INTERMITTENT, problem=LOST, window_s=60.0)


@pytest.mark.parametrize(
    ("texts", "wrong"),
    [
        ([], ()),
        ([LOST], (LOST,)),
        ([LOST, REFUSED], (REFUSED,)),
        ([LOST, FOUND], ()),
        ([LOST, UNHEARD, FOUND], (UNHEARD,)),
        ([UNHEARD, HEARD], ()),
        ([NEVER_HEARD, UNHEARD, HEARD], ()),
        ([WRONG, LOST, FOUND], (WRONG,)),
        ([COMES_AND_GOES], (COMES_AND_GOES,)),
        ([COMES_AND_GOES, FOUND], ()),
        ([Text(NoticeCode.NC_SLOW, period_s=1.0), plain(str(LOST))], ()),
    ],
    ids=[
        "nothing",
        "lost",
        "for another reason",
        "and found",
        "and unheard",
        "heard",
        "for two reasons",
        "disarmed",
        "intermittent",
        "steady",
        "of something else",
    ],
)
def test_what_is_not_ended_is_still_wrong(texts: list[Text], wrong: tuple[Text, ...]) -> None:
    assert still_wrong(texts) == wrong
