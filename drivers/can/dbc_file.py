"""The part of a DBC file that channels need: everything else in it may be wrong, or unknown to the library.

Statements are found line by line, so that the library reads only the messages in use: for a signal that is longer than
its frame it builds a description of gigabytes.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*+(?:"|\\?\Z)', re.DOTALL)
"""A last one may have no end: it is found once, and left as it is."""
_MESSAGE = re.compile(r"\s*BO_\s+(?P<id>\d+)\s+(?P<name>\w+)\s*:\s*(?P<bytes>\d+)\b")
_SIGNAL = re.compile(r"\s*SG_\s+(?P<name>\w+)\s*(?:m\d+M?|M)?\s*:\s*(?P<start>\d+)\|(?P<bits>\d+)@(?P<order>[01])[+-]")
_OF_MESSAGE = re.compile(r"^[ \t]*(?:SIG_VALTYPE_|SG_MUL_VAL_)\s+(\d+)\s+(\w+)", re.MULTILINE)
"""The begin of a statement, which a semicolon ends."""
_BOM = "\ufeff", "ï»¿"
MOST_DBC_BYTES = 2**23
"""Of a file; those of whole vehicles have a third of that."""
_MOST_BITS = 64
_MOST_MESSAGE_BYTES = 1785
"""Of several frames of SAE J1939."""
_MOST_PAGES = 2**16
_LONGEST_LINE = 2**14
"""Of a signal, with its unit and receivers."""
_SENDER = "Vector__XXX"
"""Nobody in particular: who sends a message does not matter."""
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_LARGEST = 2**32


def places(start: int, bits: int, *, little_endian: bool) -> list[int]:
    """Where each bit of a signal is in the data as a little-endian number, the lowest first."""
    if little_endian:
        return list(range(start, start + bits))
    found = [start]  # of its highest bit; the next byte follows the lowest bit of this one
    while len(found) < bits:
        found.append(found[-1] - 1 if found[-1] % 8 else found[-1] + 15)
    return found[::-1]


@dataclass(slots=True)
class DbcMessage:
    """One message as the file states it."""

    identifier: int
    """With bit 31 for a 29-bit one."""
    name: str
    bytes: int
    line: str
    signals: dict[str, list[str]] = field(default_factory=dict)
    """The lines that state each signal: one, or several with the same name."""

    def whole(self, name: str) -> bool:
        """Whether the signal is a number of at most 64 bits that stands in the message."""
        return all(self._fits(line) for line in self.signals[name])

    def _fits(self, line: str) -> bool:
        found = _SIGNAL.match(line) if len(line) <= _LONGEST_LINE else None
        if found is None or not 0 < _number(found["bits"]) <= min(_MOST_BITS, 8 * self.bytes):
            return False
        if self.bytes > _MOST_MESSAGE_BYTES:
            return False
        return (
            max(places(_number(found["start"]), _number(found["bits"]), little_endian=found["order"] == "1"))
            < 8 * self.bytes
        )


class DbcFile:
    """The messages of a file, by name; those with a name that occurs twice are in `twice`."""

    def __init__(self, text: str) -> None:
        for mark in _BOM:
            text = text.removeprefix(mark)
        # Only comments have lines within a text; their words are no statements.
        self._text = _TEXT.sub(_on_one_line, text)
        found = list(_messages(self._text))
        self.messages: Mapping[str, DbcMessage] = {message.name: message for message in found}
        names = sorted(message.name for message in found)
        self.twice = {name for name, several in groupby(names) if len(list(several)) > 1}

    def only(self, wanted: Collection[DbcMessage]) -> str:
        """A DBC file of these messages, without signals that do not fit, attributes and comments.

        Raises ValueError for a signal in more frames than can be told apart.
        """
        lines, kept = ['VERSION ""', "NS_ :", "BS_:", "BU_:"], set()
        for message in wanted:
            lines.append(message.line)
            for name, stated in message.signals.items():
                if len(stated) == 1 and message.whole(name):
                    lines += stated
                    kept.add((message.identifier, name))
            lines.append("")
        *ended, _ = self._text.split(";")
        for part in ended:
            if (found := _OF_MESSAGE.search(part)) is not None and (_number(found[1]), found[2]) in kept:
                lines.append(_checked(f"{part[found.start() :]};"))
        return "\n".join((*lines, ""))


def _on_one_line(quoted: re.Match[str]) -> str:
    text = quoted[0]
    return text.replace("\r", " ").replace("\n", " ") if len(text) > 1 and text.endswith('"') else text


def _number(digits: str) -> int:
    """No number of a DBC file has more than 32 bits; a larger one is too large everywhere."""
    return int(digits) if len(digits) <= len(str(_LARGEST)) else _LARGEST


def _checked(statement: str) -> str:
    """The library makes a list of all the numbers of such a statement."""
    pages = sum(_number(last) - _number(first) for first, last in _RANGE.findall(statement))
    if pages > _MOST_PAGES:
        raise ValueError(f"{statement.strip()[:80]}: {pages} selectors; expected at most {_MOST_PAGES}")
    return statement


def _messages(text: str) -> Iterator[DbcMessage]:
    message: DbcMessage | None = None
    for line in text.splitlines():
        if (begun := _MESSAGE.match(line)) is not None:
            if message is not None:
                yield message
            message = DbcMessage(_number(begun["id"]), begun["name"], _number(begun["bytes"]), f"{begun[0]} {_SENDER}")
        elif message is not None and (signal := _SIGNAL.match(line)) is not None:
            message.signals.setdefault(signal["name"], []).append(line)
    if message is not None:
        yield message
