"""What a gateway says stands on the page in each language; what only an earlier program said stays as it is."""

import pytest

from gateway.config.consequences import unarmed
from gateway.listeners.web.sentences import InEach, Sentence, ToldName, told
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, languages, plain
from gateway.telemetry.fields import coded, text_from
from tests.benches.telemetry_examples import configuration


def said(text: Text, language: str) -> str:
    """A text as the browser writes it."""
    match told(text).values["text"]:
        case InEach(x):
            return x[language]
        case other:
            raise TypeError(other)


def test_what_a_configuration_leaves_off_is_said_in_each_language() -> None:
    for text in unarmed(configuration("mill")):
        assert len({said(text, language) for language in languages()}) == len(languages())


@pytest.mark.parametrize("text", ["the spindle sings", "<script>alert(1)</script>", "", "x" * 100_000])
def test_what_only_an_earlier_program_said_stays_as_it_is(text: str) -> None:
    assert told(text_from(text, None)) == Sentence("sentence.text", {"text": ToldName(text)})


def test_what_a_later_program_says_stays_as_it_is() -> None:
    later = text_from("the spindle sings", coded(Text("sings", note="a")))
    assert {said(later, language) for language in languages()} == {"the spindle sings"}


def test_values_that_nest_without_end_are_shown() -> None:
    text = plain("end")
    for _ in range(50):
        text = Text(NoticeCode.PROBING_BLOCKED, reason=text)
    assert said(text, "de").startswith("Messen: Messen: ")
