"""The catalogue has every text of the page in every language; pages contain no scripts or styles of their own."""

import re
from importlib.resources import files
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from drivers.base import Quality
from gateway.listeners.web.app import build_app
from gateway.listeners.web.catalogue import chosen_language, page_texts
from gateway.listeners.web.settings import MachineUse, WebSettings
from gateway.model.compensation import Source
from gateway.model.control_state import NcState
from gateway.model.standing import Standing
from gateway.model.text import languages, places, texts
from gateway.telemetry.subscriber.site import SiteSeen
from talc.frame import EventKind, Phase, Why
from talc.names import THERMAL_ERRORS
from tests.benches.heard import BEGAN

ROOM = Path(str(files("gateway.listeners.web")))
TEMPLATES = sorted((ROOM / "templates").glob("*.html"))
CODE = "\n".join(file.read_text("utf-8") for file in sorted(ROOM.glob("*.py")))
SCRIPTS = sorted((ROOM / "static").glob("*.js"))
SCRIPT = "\n".join(file.read_text("utf-8") for file in SCRIPTS)
WORDS = {
    f"{group}.{text}"
    for group, known in (
        ("quality", Quality),
        ("source", Source),
        ("standing", Standing),
        ("phase", Phase),
        ("why", Why),
        ("event", EventKind),
        ("nc", NcState),
        ("error", THERMAL_ERRORS),
    )
    for text in known
}
SAID = (
    {key for template in TEMPLATES for key in re.findall(r't\["([\w.]+)"\]', template.read_text("utf-8"))}
    | set(re.findall(r'(?:Sentence|SaidRow|Verdict\(Colour\.\w+,)\(?\s*"([a-z_]+\.[a-z_]+)"', CODE))
    | set(re.findall(r'"((?:word|help|clock)\.[a-z_]+|gateway\.(?:alive|gone))"', CODE))
    | set(re.findall(r'"([a-z_]+\.[a-z_]+)"', SCRIPT))
    | WORDS
)


def test_the_texts_that_are_said_were_found() -> None:
    assert len(SAID) > 150
    assert {"word.ready", "because.left", "label.phase", "part.tool", "events.no_match", "why.novelty"} <= SAID


@pytest.mark.parametrize("language", languages())
def test_every_text_that_is_said_is_in_the_catalogue(language: str) -> None:
    assert SAID - texts(language).keys() == set()


def test_no_text_is_there_that_nothing_says() -> None:
    """Except groups whose key comes with a message or is composed."""
    said = CODE + SCRIPT + "".join(template.read_text("utf-8") for template in TEMPLATES)
    composed = {"mode", "expert", "body", "mark", "chart", "command", "screen", "do"}
    groups = {key.split(".")[0] for key in WORDS} | composed
    assert [key for key in page_texts("en") if key.split(".")[0] not in groups and key not in said] == []


def test_every_language_fills_in_the_same_names() -> None:
    """Apart from the words of profiles, Modbus and the operating system, which come in English."""
    first, *others = (texts(language) for language in languages())
    groups = {key.split(".")[0] for key in first}
    for other in others:
        assert {key for key in other if key.split(".")[0] in groups} == first.keys()
        differ = {key for key, text in first.items() if places(text).keys() != places(other[key]).keys()}
        assert differ <= {"text.failed"}, "drivers speak English, where the kind of the error need not be said"


@pytest.mark.parametrize(
    ("asked", "accepted", "language"),
    [
        (None, "", "en"),
        (None, "de-CH,de;q=0.9,en;q=0.8", "de"),
        (None, "fr, en;q=0.5, de;q=0.7", "de"),
        (None, "fr", "en"),
        (None, "de;q=x", "en"),
        ("de", "en", "de"),
        ("../etc", "de", "de"),
    ],
)
def test_the_language_is_the_browsers_unless_another_is_asked_for(
    asked: str | None, accepted: str, language: str
) -> None:
    assert chosen_language(asked, accepted) == language


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda path: path.name)
def test_no_template_has_its_own_script_style_or_handler(template: Path) -> None:
    text = template.read_text("utf-8")
    assert re.findall(r"<style|\sstyle=|\son\w+=|javascript:|\|\s*safe", text) == []
    for attributes in re.findall(r"<script([^>]*)>", text):
        assert "src=" in attributes or 'type="application/json"' in attributes


def test_the_page_makes_no_markup_of_what_it_is_sent() -> None:
    assert re.findall(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new Function", SCRIPT) == []


def test_texts_and_names_stay_texts_in_the_page() -> None:
    """A declared machine may have any name; nothing in the name becomes markup."""
    name = '<script>alert("x")<b>'
    site = SiteSeen("talc", (name,), lambda: BEGAN, lambda: 0.0)
    page = TestClient(build_app(site, WebSettings(), uses={name: MachineUse()}), base_url="http://localhost")
    html = page.get("/machine/%3Cscript%3Ealert(%22x%22)%3Cb%3E").text
    assert "<script>alert" not in html
    assert html.count("<script") == 4
