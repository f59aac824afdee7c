"""Each code in each language: every value is written, nothing is left over, and whoever says it gives what it needs."""

import ast
import html
import io
import re
import tomllib
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from rich.console import Console

from drivers.base import NoAnswer
from gateway.listeners.watch.view import LiveView, ViewState
from gateway.model.codes import NoticeCode
from gateway.model.text import (
    NOTHING,
    Language,
    Text,
    Value,
    failure,
    languages,
    places,
    plain,
    restored,
    texts,
    values_of,
)  # fmt: skip
from gateway.reporting.page import build
from gateway.service.status import Status, written
from talc.frame import Event, EventKind
from talc.kinds import EventCode
from tests.benches.small_run import small_run

ROOT = Path(__file__).parents[3]
OF_DRIVERS = [
    tomllib.loads(file.read_text(encoding="utf-8"))["text"] for file in (ROOT / "drivers").rglob("texts.toml")
]
CODES = (*NoticeCode, *EventCode, *(code for family in OF_DRIVERS for code in family if code not in [*NoticeCode]))
AT = datetime(2026, 3, 2, 6, 5, 4, tzinfo=UTC)
WORDS = {"quality": "comm_fault", "why": "interval", "standing": "blocked", "phase": "no_good", "fault": "NoAnswer"} | {
    "armed_mode": "advise",
    "moment": "lately",
    "slowed": "hot",
    "file_word": "lines",
    "input_fault": "fahrenheit",
    "measurement_fault": "stuck",
    "system_error": "Connection refused",
    "of_profile": "open circuit",
    "nothing": "none",
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
def test_each_code_is_said_in_each_language_with_all_its_values(language: str) -> None:
    for code in CODES:
        text = said(code)
        written = text.in_language(language)
        assert not re.search(r"[{}]", written), code
        assert written, code
        for name, forms in places(template(code, language)).items():
            if forms == {""}:
                assert str(text.values[name]) in written, code
        assert not re.search(r"[{}]", text), code


def test_no_sentence_is_there_that_nobody_can_say_and_none_is_missing() -> None:
    for language in languages():
        assert {key for key in texts(language) if key.startswith("text.")} == {f"text.{code}" for code in CODES}
    assert len({*CODES}) == len(CODES), "a code means one thing"


def test_a_decimal_point_is_that_of_the_language_and_words_are_translated() -> None:
    text = Text(EventCode.LIMIT_EXCEEDED, error="EZ0A", value=39.24, unit="µm", limit=5.0)
    assert "39.2" in text.in_language("en")
    assert "39,2" in text.in_language("de")
    bad = Text(NoticeCode.CHANNEL_BAD, channel="bed", quality="comm_fault")
    assert "comm_fault" in str(bad), "raw, it has the published word"
    assert texts("de")["quality.comm_fault"] in bad.in_language("de")


@pytest.mark.parametrize("language", languages())
def test_an_error_above_its_limit_is_said_with_what_to_do(language: str) -> None:
    values, _, advice = template(EventCode.LIMIT_EXCEEDED, language).rpartition("}")
    assert "{limit" in values
    assert len(advice.split()) > 5, "more than the number's end"


def test_a_text_is_the_same_after_it_was_stored_or_published() -> None:
    for code in CODES:
        text = Text(NoticeCode.PROBING_BLOCKED, reason=said(code))
        again = restored(str(text), *values_of(text))
        assert again == text, code
        assert again.says(code), code
        assert [again.in_language(each) for each in languages()] == [text.in_language(each) for each in languages()]


def test_words_of_others_have_no_code_and_stay_as_they_are() -> None:
    assert values_of("wire break") == ("", {})
    assert {plain("wire break").in_language(each) for each in languages()} == {"wire break"}
    assert not NOTHING


@pytest.mark.parametrize("language", languages())
def test_an_error_of_a_driver_is_said_with_its_place_and_what_to_do_in_each_language(language: str) -> None:
    error = NoAnswer(said("modbus_unit_silent"), bus="rtu1", device="rtd1", hint=said("check_unit"))
    found = failure(error)
    heard = restored(str(found), *values_of(found)).in_language(language)
    parts = error.what, error.hint, Text(NoticeCode.BUS, name="rtu1"), Text(NoticeCode.DEVICE, name="rtd1")
    assert [part for part in parts if part.in_language(language) not in heard] == []


@pytest.mark.slow
@pytest.mark.parametrize("language", languages())
def test_each_renderer_says_each_code_in_each_language(language: str) -> None:
    """Of the terminal and the report; the page has its own test."""
    texts_said = [said(code) for code in CODES]
    wanted = [" ".join(text.in_language(language).split()) for text in texts_said]
    off = dict[str, tuple[float | None, str, str]]()
    status = Status(
        "mill", True, "no_good", 7.0, texts_said[0], (), None, None, off, (), tuple(texts_said),
        tuple((AT, text) for text in texts_said), True, False,
    )  # fmt: skip
    terminal_lines = "\n".join(written(status, 0, Language(language)))
    view, drawn = ViewState("mill"), io.StringIO()
    console = Console(width=100_000, markup=False, emoji=False, file=drawn)
    view.events = deque(((AT, EventKind.PROBLEM, text) for text in texts_said), maxlen=None)
    view.events_seen = len(texts_said)
    with LiveView(view, plain=True, console=console, language=language):
        pass
    events = tuple((0.0, Event(EventKind.PROBLEM, text)) for text in texts_said)
    page = html.unescape(build(replace(small_run(), events=events, language=language)))
    for rendered in (terminal_lines, drawn.getvalue(), page):
        shown = " ".join(rendered.split())
        assert [text for text in wanted if text not in shown] == []


@pytest.mark.slow
@pytest.mark.parametrize("language", languages())
def test_what_matters_has_a_remedy_and_both_have_all_their_values(language: str) -> None:
    known = texts(language)
    codes = [key.removeprefix("remedy.") for key in known if key.startswith("remedy.")]
    assert codes == [key.removeprefix("matters.") for key in known if key.startswith("matters.")]
    assert set(codes) <= set(CODES)
    found = list(spoken())
    for group in ("remedy", "matters"):
        for code in codes:
            needed = places(known[f"{group}.{code}"]).keys()
            assert all(needed <= names for _, said_code, names in found if said_code == code), (group, code)


def spoken() -> Iterator[tuple[str, str, frozenset[str]]]:
    """Each `Text(code, name=...)` of gateway and drivers: where it is, its code, and the names that it gives."""
    for file in (*(ROOT / "gateway").rglob("*.py"), *(ROOT / "drivers").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Name("Text"),
                    args=[ast.Attribute(value=ast.Name("NoticeCode"), attr=code)],
                    keywords=keywords,
                ) if all(keyword.arg for keyword in keywords):
                    names = frozenset(str(keyword.arg) for keyword in keywords)
                    yield f"{file.relative_to(ROOT)}:{node.lineno}", NoticeCode[code], names
                case ast.Call(func=ast.Name("Text"), args=[ast.Constant(value=str(code))], keywords=keywords) if (
                    file.is_relative_to(ROOT / "drivers")
                ):
                    names = frozenset(str(keyword.arg) for keyword in keywords)
                    yield f"{file.relative_to(ROOT)}:{node.lineno}", code, names
                case _:
                    pass


@pytest.mark.slow
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
