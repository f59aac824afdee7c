"""What a gateway says stands on the page in each language; what only an earlier program said stays as it is."""

import json

import pytest

from gateway.config.consequences import unarmed
from gateway.listeners.web.sentences import InEach, Sentence, ToldName, told
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, languages, plain
from gateway.telemetry.fields import coded, text_from
from talc.kinds import EventCode
from tests.benches.telemetry_examples import configuration


def heard(text: Text) -> Text:
    """After it has passed the network as JSON."""
    of = coded(text)
    assert of is not None
    values = json.loads(json.dumps(of.values))
    return text_from(str(text), type(of)(of.code, values))


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


DIRT = plain("dirt")


@pytest.mark.parametrize(
    ("text", "german"),
    [
        (
            Text(EventCode.LIMIT_EXCEEDED, error="EZ0A", value=39.24, unit="µm", limit=5.0),
            "EZ0A: Rest 39,2 µm über der Grenze 5,0",
        ),
        (
            Text(EventCode.PHASE_CHANGED, phase="calibration", next="compensation"),
            "Kalibrierung → Kompensation",
        ),
        (
            Text(NoticeCode.CHANNEL_BAD_BECAUSE, channel="bed_1", quality="comm_fault", detail="no answer"),
            "Kanal bed_1: keine Verbindung: no answer",
        ),
        (
            Text(NoticeCode.PROBING_BLOCKED, reason=Text(NoticeCode.NC_UNREACHABLE)),
            "Messen: die Steuerung ist nicht zu erreichen",
        ),
        (
            Text(NoticeCode.PROBING_BLOCKED, reason=Text(NoticeCode.NC_ALARM, numbers=("700123", "21612"))),
            "Messen: Alarm 700123, 21612",
        ),
        (
            Text(NoticeCode.PAUSE_AFTER_REJECTS, n=1, reason=DIRT),
            "Pause nach einem verworfenen Ergebnis: dirt",
        ),
        (
            Text(NoticeCode.PAUSE_AFTER_REJECTS, n=2, reason=DIRT),
            "Pause nach 2 verworfenen Ergebnissen: dirt",
        ),
        (
            Text(
                NoticeCode.WAITS_MEASUREMENT_BECAUSE,
                why="uncertainty",
                standing="blocked",
                reason=Text(NoticeCode.NC_OTHER_MODE, mode="JOG"),
            ),
            "eine Messung (die Schätzung ist unsicher geworden): gewünscht, aber blockiert: die Steuerung ist in JOG,"
            " nicht in AUTO",
        ),
        (
            Text(NoticeCode.OPENED_AGAIN, subject=Text(NoticeCode.BUS, name="rtu1")),
            "Bus rtu1: wieder offen",
        ),
    ],
)
def test_a_text_is_said_in_german_and_what_it_quotes_stays(text: Text, german: str) -> None:
    assert said(heard(text), "de") == german


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
