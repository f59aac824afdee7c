"""Each code in each language: every value is written, nothing is left over, and whoever says it gives what it needs."""

import ast
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from gateway.model.codes import MUST_ACT, NoticeCode, Severity, severity_of
from gateway.model.text import NOTHING, Text, Value, languages, places, plain, restored, texts, values_of
from talc.kinds import EventCode

ROOT = Path(__file__).parents[3]
CODES = (*NoticeCode, *EventCode)
AT = datetime(2026, 3, 2, 6, 5, 4, tzinfo=UTC)
WORDS = {"quality": "comm_fault", "why": "interval", "standing": "blocked", "phase": "no_good", "fault": "NoAnswer"} | {
    "mode": "advise", "moment": "lately", "slowed": "hot"
}


def template(code: str, language: str) -> str:
    return texts(language)[f"text.{code}"]


def sample(name: str, forms: frozenset[str]) -> Value:
    """A value that these forms can write."""
    for form in forms:
        if form in ("minute", "clock"):
            return AT
        if form in WORDS:
            return WORDS[form]
        if form:
            return 7 if form.startswith("|") else 3.25
    return f"[{name}]"


def said(code: str) -> Text:
    """The text of a code, with a value for each name in any language."""
    found: dict[str, frozenset[str]] = {}
    for language in languages():
        for name, forms in places(template(code, language)).items():
            found[name] = found.get(name, frozenset()) | forms
    return Text(code, **{name: sample(name, forms) for name, forms in found.items()})


@pytest.mark.parametrize("language", languages())
@pytest.mark.parametrize("code", CODES)
def test_each_code_is_said_in_each_language_with_all_its_values(code: str, language: str) -> None:
    text = said(code)
    written = text.in_language(language)
    assert not re.search(r"[{}]", written)
    assert written
    for name, forms in places(template(code, language)).items():
        if forms == {""}:
            assert f"[{name}]" in written
    assert not re.search(r"[{}]", text)


def test_no_sentence_is_there_that_nobody_can_say_and_none_is_missing() -> None:
    for language in languages():
        assert {key for key in texts(language) if key.startswith("text.")} == {f"text.{code}" for code in CODES}
    assert len({*CODES}) == len(CODES), "a code means one thing"


def test_a_decimal_point_is_that_of_the_language_and_words_are_translated() -> None:
    text = Text(EventCode.LIMIT_EXCEEDED, error="EZ0A", value=39.24, unit="µm", limit=5.0)
    assert (text.in_language("en"), text.in_language("de")) == (str(text), "EZ0A: Rest 39,2 µm über der Grenze 5,0")
    bad = Text(NoticeCode.CHANNEL_BAD, channel="bed", quality="comm_fault")
    assert str(bad) == "channel bed: comm_fault", "raw, it has the published word"
    assert bad.in_language("de") == "Kanal bed: keine Verbindung"


@pytest.mark.parametrize("code", CODES)
def test_a_text_is_the_same_after_it_was_stored_or_published(code: str) -> None:
    text = Text(NoticeCode.PROBING_BLOCKED, reason=said(code))
    again = restored(str(text), *values_of(text))
    assert again == text
    assert again.says(code)
    assert [again.in_language(each) for each in languages()] == [text.in_language(each) for each in languages()]


def test_words_of_others_have_no_code_and_stay_as_they_are() -> None:
    assert values_of("wire break") == ("", {})
    assert {plain("wire break").in_language(each) for each in languages()} == {"wire break"}
    assert not NOTHING


def test_what_a_person_must_do_something_about_is_no_mere_information() -> None:
    assert {severity_of(code) for code in MUST_ACT} <= {Severity.PROBLEM, Severity.NOTICE}
    assert {severity_of(code) for code in NoticeCode} == set(Severity)


def spoken() -> Iterator[tuple[str, str, frozenset[str]]]:
    """Each `Text(NoticeCode.X, name=...)` of the gateway: where it is, its code, and the names that it gives."""
    for file in (ROOT / "gateway").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Name("Text"),
                    args=[ast.Attribute(value=ast.Name("NoticeCode"), attr=code)],
                    keywords=keywords,
                ) if all(keyword.arg for keyword in keywords):
                    names = frozenset(str(keyword.arg) for keyword in keywords)
                    yield f"{file.relative_to(ROOT)}:{node.lineno}", NoticeCode[code], names
                case _:
                    pass


def test_whoever_says_something_gives_every_value_that_a_language_needs() -> None:
    found = list(spoken())
    assert len(found) > 80
    wrong = [
        (where, code, language)
        for where, code, names in found
        for language in languages()
        if not places(template(code, language)).keys() <= names
    ]
    assert wrong == []
