"""The part of a DBC file that channels need: everything else in it may be wrong, or unknown to the library.

Statements are found line by line, so that the library reads only the messages in use: for a signal that is longer than
its frame it builds a description of gigabytes.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
_MESSAGE = re.compile(r"\s*BO_\s+(?P<id>\d+)\s+(?P<name>\w+)\s*:\s*(?P<bytes>\d+)\b")
_SIGNAL = re.compile(r"\s*SG_\s+(?P<name>\w+)\s*(?:m\d+M?|M)?\s*:\s*(?P<start>\d+)\|(?P<bits>\d+)@(?P<order>[01])[+-]")
_OF_MESSAGE = re.compile(r"^\s*(?:SIG_VALTYPE_|SG_MUL_VAL_)\s+(\d+)\s+(\w+)[^;]*;", re.MULTILINE)
_BOM = "\ufeff", "ï»¿"
_MOST_BITS = 64


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
        found = _SIGNAL.match(line)
        if found is None or not 0 < int(found["bits"]) <= min(_MOST_BITS, 8 * self.bytes):
            return False
        return (
            max(places(int(found["start"]), int(found["bits"]), little_endian=found["order"] == "1")) < 8 * self.bytes
        )


class DbcFile:
    """The messages of a file, by name; those with a name that occurs twice are in `twice`."""

    def __init__(self, text: str) -> None:
        for mark in _BOM:
            text = text.removeprefix(mark)
        # Only comments have lines within a text; their words are no statements.
        self._text = _TEXT.sub(lambda quoted: quoted[0].replace("\r", " ").replace("\n", " "), text)
        found = list(_messages(self._text))
        self.messages: Mapping[str, DbcMessage] = {message.name: message for message in found}
        names = sorted(message.name for message in found)
        self.twice = {name for name, several in groupby(names) if len(list(several)) > 1}

    def only(self, wanted: Collection[DbcMessage]) -> str:
        """A DBC file of these messages, without signals that do not fit and without attributes and comments."""
        lines, kept = ['VERSION ""', "NS_ :", "BS_:", "BU_:"], set()
        for message in wanted:
            lines.append(message.line)
            for name, stated in message.signals.items():
                if len(stated) == 1 and message.whole(name):
                    lines += stated
                    kept.add((message.identifier, name))
            lines.append("")
        lines += [found[0] for found in _OF_MESSAGE.finditer(self._text) if (int(found[1]), found[2]) in kept]
        return "\n".join((*lines, ""))


def _messages(text: str) -> Iterator[DbcMessage]:
    message: DbcMessage | None = None
    for line in text.splitlines():
        if (begun := _MESSAGE.match(line)) is not None:
            if message is not None:
                yield message
            message = DbcMessage(int(begun["id"]), begun["name"], int(begun["bytes"]), line)
        elif message is not None and (signal := _SIGNAL.match(line)) is not None:
            message.signals.setdefault(signal["name"], []).append(line)
    if message is not None:
        yield message
