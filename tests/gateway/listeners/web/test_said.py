"""The gateway's own texts, published in English, are sentences of the catalogue and are found there."""

import json
import re

import pytest
from gateway.listeners.web.said import told

from gateway.config.consequences import unarmed
from gateway.listeners.web.sentences import Amount, Sentence, ToldName, Word
from gateway.model.text import texts
from tests.benches.played_telemetry import SAMPLES
from tests.benches.telemetry_examples import configuration


def said(sentence: Sentence, language: str) -> str:
    """A text as the browser writes it."""

    def write(found: re.Match[str]) -> str:
        match sentence.values[found[1]]:
            case Sentence() as inner:
                return said(inner, language)
            case Word(w):
                return texts(language)[w]
            case Amount(n, _, d):
                return f"{n:.{d}f}"
            case ToldName(s):
                return s
            case other:
                raise TypeError(other)

    return re.sub(r"\{(\w+)\}", write, texts(language)[sentence.say])


def published() -> set[str]:
    """Everything that the demo's gateway reported about itself in a day."""
    found = set[str]()
    for line in SAMPLES.read_text(encoding="utf-8").splitlines():
        message = json.loads(line)
        if message["key"] == "event":
            found.add(message["message"]["text"])
        if message["key"] == "probing":
            found |= {message["message"]["reason"], message["message"]["operator"]} - {""}
    return found


def test_everything_that_the_demo_said_is_known_and_stays_as_it_was_in_english() -> None:
    found = published()
    assert len(found) >= 10
    assert {text for text in found if told(text).say == "sentence.text"} == set()
    for text in found:
        if " -> " not in text:  # the page has its own words for the phases
            assert said(told(text), "en") == text


def test_what_a_configuration_leaves_off_is_known() -> None:
    consequences = unarmed(configuration("mill"))
    assert consequences
    assert all(told(text).say.startswith("said.") for text in consequences)


@pytest.mark.parametrize(
    ("text", "german"),
    [
        ("EZ0A: residual 39.2 µm above its limit 5.0", "EZ0A: Rest 39.2 µm über der Grenze 5.0"),
        ("calibration -> compensation", "Kalibrierung → Kompensation"),
        ("channel bed_1: comm_fault: no answer within 0.5 s", "Kanal bed_1: keine Verbindung: no answer within 0.5 s"),
        ("channel bed_1: good again", "Kanal bed_1: wieder gut"),
        ("probing: the control cannot be reached", "Messen: die Steuerung ist nicht zu erreichen"),
        ("probing: alarm 700123, 21612", "Messen: Alarm 700123, 21612"),
        ("probing: pause after 1 rejected result: dirt", "Messen: Pause nach einem verworfenen Ergebnis: dirt"),
        ("probing: pause after 2 rejected results: dirt", "Messen: Pause nach 2 verworfenen Ergebnissen: dirt"),
        (
            "a measurement (uncertainty): blocked: the control is in JOG, not in AUTO",
            "eine Messung (die Schätzung ist unsicher geworden): gewünscht, aber blockiert: die Steuerung ist in JOG,"
            " nicht in AUTO",
        ),
        ("anna: pause accepted: it is done", "anna: pause angenommen: it is done"),
        ("bus rtu1: open again", "bus rtu1: wieder offen"),
    ],
)
def test_a_known_text_is_said_in_german_and_what_it_quotes_stays(text: str, german: str) -> None:
    assert said(told(text), "de") == german


@pytest.mark.parametrize(
    "text", ["the spindle sings", "<script>alert(1)</script>", "", "x" * 100_000, "probing:" * 900]
)
def test_an_unknown_text_stays_as_it_is(text: str) -> None:
    assert told(text) == Sentence("sentence.text", {"text": ToldName(text)})


def test_a_text_that_quotes_itself_ends() -> None:
    assert said(told("probing: " * 50 + "alarm 1"), "en") == "probing: " * 50 + "alarm 1"
