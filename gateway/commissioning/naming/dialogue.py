"""What `talc-gateway name` says when a sensor moves, and when something is typed. No terminal, no bus, no file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.commissioning.naming.names import Given, Input, Listed, Names
from gateway.commissioning.naming.warmed import Warmed
from gateway.config.problems import ConfigError
from gateway.model.text import Language

UNDO, NO, END, YES = "undo", "no", "end", "y"
"""Words that are typed; no sensor can be called so."""
Keep = Callable[[Given, Warmed | None, bool], None]
"""Writes a name into file and protocol, with what was seen, or takes it back there. Raises ConfigError."""


@dataclass(slots=True)
class _Question:
    input: Input
    seen: Warmed
    usual: str
    """What an empty line means; empty: that it is another sensor."""


class Dialogue:
    """One session. `ended` is True when nothing is left to do.

    Parameters
    ----------
    names: channels, list, and what was given
    channels: names of the channels as the bus reads them, to their inputs
    say: prints a line
    keep: writes what was given
    again: forgets what was read until now, because from here on another sensor is warmed
    """

    def __init__(
        self,
        names: Names,
        channels: Mapping[str, Input],
        said: Language,
        say: Callable[[str], None],
        keep: Keep,
        again: Callable[[], None],
    ) -> None:
        self.names, self._channels, self._said, self._say = names, channels, said, say
        self._keep, self._again = keep, again
        self._question: _Question | None = None
        self._announced: Listed | None = None
        self._last_of_list = False
        self._unclear: tuple[str, str] | None = None
        self.ended = False

    @property
    def waiting(self) -> bool:
        """Whether it waits for a sensor to move, and not for an answer."""
        return not (self.ended or self._question or self._last_of_list)

    def begin(self) -> None:
        """Say what to do."""
        self._say(self._said("naming.head", n=len(self.names.now)))
        if self.names.given:
            self._say(self._said("naming.resumed", done=len(self.names.given)))
        self._next()

    def moved(self, seen: Warmed) -> None:
        """A sensor rises."""
        if not seen.clear:
            if seen.rising and seen.second and (pair := (seen.channel, seen.second)) != self._unclear:
                self._unclear = pair
                self._say(self._said("naming.several", one=self._now(pair[0]), other=self._now(pair[1])))
            return
        place = self._channels[seen.channel]
        if place in self.names.named:
            self._say(self._said("naming.already", name=self.names.now[place]))
            self._next()
            return
        wanted = self._announced or self.names.next_listed
        self._say(self._rose(place, seen))
        if wanted is not None and wanted.input in (None, place):
            self._give(_Question(place, seen, ""), wanted.name)
            return
        self._question = _Question(place, seen, self.names.listed_at(place))
        self._ask(self._question)

    def typed(self, line: str) -> None:
        """What somebody types."""
        word, question = line.strip(), self._question
        if self._last_of_list:
            self._as_listed(word)
        elif word == END:
            self._end()
        elif word == UNDO:
            self._undo()
        elif question is None:
            if word:
                self._announced = Listed(word)
            self._warm()
        elif word == NO or not (word or question.usual):
            self._next()
        else:
            self._give(question, word or question.usual)

    def _ask(self, question: _Question) -> None:
        usual = question.usual
        self._say(self._said("naming.which_listed", name=usual) if usual else self._said("naming.which"))

    def _give(self, question: _Question, name: str) -> None:
        try:
            given = self.names.give(question.input, name, "warmed")
        except ValueError as error:
            self._refused(question, self._said.of(error.args[0]))
            return
        try:
            self._keep(given, question.seen, False)
        except ConfigError as error:
            self.names.undo()
            self._refused(question, self._said.of(error.text))
            return
        self._say(self._said("naming.given", device=given.input.device, number=given.input.number, name=given.name))
        self._next()

    def _refused(self, question: _Question, why: str) -> None:
        self._question, self._announced = _Question(question.input, question.seen, ""), None
        self._say(why)
        self._ask(self._question)

    def _undo(self) -> None:
        last = self.names.undo()
        if last is None:
            self._say(self._said("naming.nothing_given"))
            self._next()
            return
        try:
            self._keep(last, None, True)
        except ConfigError as error:
            self.names.give(last.input, last.name, last.how)
            self._say(self._said.of(error.text))
        else:
            self._say(self._said("naming.undone", device=last.input.device, number=last.input.number, name=last.name))
        self._next()

    def _next(self) -> None:
        self._question = self._announced = self._unclear = None
        self._again()
        if self.names.left:
            self._warm()
        else:
            self._end()

    def _warm(self) -> None:
        done, all_of = len(self.names.given), len(self.names.now)
        wanted = self._announced or self.names.next_listed
        if wanted is None:
            self._say(self._said("naming.warm_any", done=done, n=all_of))
        elif wanted.input is None:
            self._say(self._said("naming.warm", done=done, n=all_of, name=wanted.name))
        else:
            self._say(self._said("naming.warm_at", done=done, n=all_of, name=wanted.name,
                                 device=wanted.input.device, number=wanted.input.number))  # fmt: skip

    def _end(self) -> None:
        self._question = None
        if left := self._listed_left():
            self._last_of_list = True
            self._say(self._said("naming.rest", n=len(left), word=YES))
        else:
            self.ended = True

    def _listed_left(self) -> list[tuple[Input, str]]:
        done, given = self.names.named, {each.name for each in self.names.given}
        return [
            (each.input, each.name)
            for each in self.names.listed
            if each.input is not None and each.input not in done and each.name not in given
        ]

    def _as_listed(self, word: str) -> None:
        self.ended = True
        if word.lower() not in (YES, "yes", "j", "ja"):
            return
        for place, name in self._listed_left():
            given = self.names.give(place, name, "listed")
            try:
                self._keep(given, None, False)
            except ConfigError as error:
                self.names.undo()
                self._say(self._said.of(error.text))

    def _rose(self, place: Input, seen: Warmed) -> str:
        rose = self._said("naming.rose", device=place.device, number=place.number, now=self.names.now[place],
                          rise=seen.rise, unit=seen.unit)  # fmt: skip
        if not seen.second:
            return rose
        return rose + self._said("naming.second", second=self._now(seen.second), rise=seen.second_rise)

    def _now(self, channel: str) -> str:
        return self.names.now[self._channels[channel]]
