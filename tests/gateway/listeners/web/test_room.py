"""The page reserves room for every text that a verdict may say."""

from gateway.listeners.web import room
from gateway.model.text import languages, texts

WITHOUT_HELP = {
    "because.gone",
    "because.never",
    "because.no_step",
    "because.no_tolerance",
    "because.old",
    "because.probing",
    "because.silent",
}
"""Beside these verdicts the page does not say what helps."""


def group(name: str) -> set[str]:
    """The texts of a group in the catalogue."""
    return {key for key in texts(next(iter(languages()))) if key.startswith(name + ".")}


def test_every_word_and_reason_has_its_room() -> None:
    assert set(room.WORDS) == group("word")
    assert set(room.SINCE) == group("since")
    assert set(room.BECAUSE) == group("because") - WITHOUT_HELP


def test_every_line_of_what_helps_has_its_room() -> None:
    lines = {key for line in room.HELPS for key in line}
    assert lines | set(room.WHAT) | set(room.OPTION) == group("when") | group("help")
    assert set(room.PLANNED) == group("planned")


def test_every_order_has_its_room() -> None:
    assert set(room.ORDER_NOTICES) == group("notice") - {"notice.unarmed", "notice.not_armed"}
