"""What is said and remembered when a name cannot be written or taken back."""

from pathlib import Path

from gateway.commissioning.naming.dialogue import Dialogue
from gateway.commissioning.naming.names import Given, Input, Names
from gateway.commissioning.naming.warmed import Warmed
from gateway.config.problems import ConfigError, Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Language, Text

BED, NUT = Input("adam", 0), Input("adam", 1)
SEEN = Warmed("in0", 3.0, "degC", rising=True, clear=True)
WHY = Text(NoticeCode.FILE_NOT_WRITTEN, error="No space left on device")


def test_a_name_that_cannot_be_taken_back_stays_given_and_the_session_goes_on() -> None:
    names, printed, full = Names({BED: "in0", NUT: "in1"}), list[str](), False

    def keep(given: Given, seen: Warmed | None, back: bool) -> None:
        if full:
            raise ConfigError(Path("gateway.toml"), [Problem("", WHY)])

    said = Language("en")
    dialogue = Dialogue(names, {"in0": BED, "in1": NUT}, said, printed.append, keep, lambda: None)
    dialogue.begin()
    dialogue.moved(SEEN)
    dialogue.typed("in1")  # the other one's name: they exchange them
    full = True
    dialogue.typed("undo")
    assert said.of(Text(NoticeCode.FILE_PROBLEM, file="gateway.toml", problem=WHY)) in printed
    assert (names.now, names.named) == ({BED: "in1", NUT: "in0"}, {BED})
    assert dialogue.waiting
    full = False
    dialogue.typed("undo")
    assert (names.now, names.named) == ({BED: "in0", NUT: "in1"}, set())
