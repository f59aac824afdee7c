"""Who is called what: the inputs of a configuration, a wiring list, the names that were given, and their protocol."""

import csv
import io
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Final

from gateway.commissioning.naming.warmed import Warmed
from gateway.config.fields import machine_name
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError, Problem
from gateway.config.reading import read_text
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_LIST: Final = ("device", "input", "now", "name")
_PROTOCOL: Final = (
    "time", "by", "device", "input", "before", "name", "how", "rise", "unit", "second", "second_rise"
)  # fmt: skip

_UNDONE: Final = "undone"


@dataclass(frozen=True, slots=True, order=True)
class Input:
    """One input of a device."""

    device: str
    number: int


@dataclass(frozen=True, slots=True)
class Listed:
    """One line of a wiring list."""

    name: str
    input: Input | None = None
    """Where it shall be connected; None: the list does not say."""


@dataclass(frozen=True, slots=True)
class Given:
    """One name that was given."""

    input: Input
    before: str
    name: str
    how: str
    """`warmed`, `listed`."""
    other: Input | None = None
    """The input that had this name, and has the earlier one now."""


@dataclass(slots=True)
class Names:
    """The channels by their inputs, what is still to be named, and what was."""

    now: dict[Input, str]
    listed: tuple[Listed, ...] = ()
    given: list[Given] = field(default_factory=list)

    @classmethod
    def of(cls, config: GatewayConfig, listed: Iterable[Listed] = ()) -> "Names":
        """Before any was given."""
        found = {Input(d.name, number): name for d in config.devices for name, number in d.channels.items()}
        return cls(found, tuple(listed))

    def resume(self, protocol: Path) -> None:
        """Take those as given that earlier sessions gave and that the configuration still has, each with what its
        undoing needs. Raises ConfigError for a protocol that cannot be read."""
        rows = [row for row in _rows(protocol) if self.now.get(row.input) == row.name]
        before = dict(self.now)
        for row in reversed(rows):
            other = next((each for each, name in before.items() if name == row.before and each != row.input), None)
            before[row.input] = row.before
            if other is not None:
                before[other] = row.name
            self.given.insert(0, replace(row, other=other))

    @property
    def named(self) -> set[Input]:
        """Inputs that have been given their name."""
        return {each.input for each in self.given}

    @property
    def left(self) -> list[Input]:
        """Those that have not, in the order of the file."""
        return [each for each in self.now if each not in self.named]

    @property
    def next_listed(self) -> Listed | None:
        """The next of the list."""
        done = {each.name for each in self.given}
        return next((each for each in self.listed if each.name not in done), None)

    def listed_at(self, place: Input) -> str:
        """What the list says of an input; empty: nothing."""
        return next((each.name for each in self.listed if each.input == place), "")

    def input_of(self, channel: str) -> Input:
        """The input that has this name now."""
        return next(place for place, name in self.now.items() if name == channel)

    def give(self, place: Input, name: str, how: str) -> Given:
        """Give it this name. Another input that has it, and was not named yet, gets the earlier one.

        Raises ValueError, if the text is no name, or that of an input that was named.
        """
        machine_name(name)
        other = next((each for each, known in self.now.items() if known == name and each != place), None)
        if other in self.named and other is not None:
            raise ValueError(Text(NoticeCode.NAME_TAKEN, name=name, device=other.device, number=other.number))
        done = Given(place, self.now[place], name, how, other)
        self.now[place] = name
        if other is not None:
            self.now[other] = done.before
        self.given.append(done)
        return done

    def undo(self) -> Given | None:
        """Take the last one back; None: none was given."""
        if not self.given:
            return None
        last = self.given.pop()
        self.now[last.input] = last.before
        if last.other is not None:
            self.now[last.other] = last.name
        return last


def changes(given: Given, *, back: bool = False) -> Mapping[str, str]:
    """The old names to the new ones that this made. back: that its undoing makes"""
    old, new = (given.name, given.before) if back else (given.before, given.name)
    if old == new:
        return {}
    return {old: new} if given.other is None else {old: new, new: old}


def checklist(config: GatewayConfig) -> str:
    """The inputs as a wiring list to print and to fill in."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(_LIST)
    for device in config.devices:
        rows.writerows((device.name, number, name, "") for name, number in device.channels.items())
    return out.getvalue()


def read_list(path: Path, config: GatewayConfig) -> list[Listed]:
    """The lines of a wiring list that have a name: CSV with a column `name`, and `device` and `input` if it says where.

    Separated by commas, semicolons or tabs. Raises ConfigError with every problem found.
    """
    text = read_text(path)
    head = text.partition("\n")[0]
    separator = max(",;\t", key=head.count)
    rows = list(csv.DictReader(io.StringIO(text), delimiter=separator))
    if "name" not in [each.strip() for each in head.split(separator)]:
        raise ConfigError(path, [Problem("", Text(NoticeCode.LIST_HEAD, head=head.strip()))])
    inputs, problems, found = set(Names.of(config).now), list[Problem](), list[Listed]()
    for number, row in enumerate(rows, start=2):
        name, device, entry = (str(row.get(key) or "").strip() for key in ("name", "device", "input"))
        if not name:
            continue
        try:
            place = Input(device, int(entry)) if device else None
            machine_name(name)
            if place is not None and place not in inputs:
                raise ValueError(Text(NoticeCode.LIST_INPUT, device=device, input=entry))
            if name in {each.name for each in found} or (place is not None and place in {e.input for e in found}):
                raise ValueError(Text(NoticeCode.LIST_TWICE))
            found.append(Listed(name, place))
        except ValueError as error:
            what = error.args[0] if isinstance(error.args[0], Text) else str(error)
            problems.append(Problem(f"line {number}", what))
    if problems:
        raise ConfigError(path, problems)
    return found


def _rows(protocol: Path) -> list[Given]:
    """What a protocol says was given and not taken back: the last name of each input."""
    found: dict[Input, Given] = {}
    text = read_text(protocol) if protocol.exists() else ""
    for row in csv.DictReader(io.StringIO(text)):
        with suppress(KeyError, TypeError, ValueError):  # somebody has edited it
            place = Input(row["device"], int(row["input"]))
            found.pop(place, None)
            if row["how"] != _UNDONE:
                found[place] = Given(place, row["before"], row["name"], row["how"])
    return list(found.values())


def written(path: Path, at: datetime, by: str, given: Given, seen: Warmed | None, *, back: bool) -> None:
    """Add one line to the protocol. back: it was taken back"""
    new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        if new:
            rows.writerow(_PROTOCOL)
        figures = ("", "", "", "") if seen is None else (
            f"{seen.rise:.2f}", seen.unit, seen.second, f"{seen.second_rise:.2f}" if seen.second else ""
        )  # fmt: skip
        rows.writerow((
            at.isoformat(timespec="seconds"), by, given.input.device, given.input.number, given.before, given.name,
            _UNDONE if back else given.how,
            *figures,
        ))  # fmt: skip
