"""docs/keys.md matches what is published, field by field, and what is answered."""

import re
from enum import StrEnum
from pathlib import Path

import msgspec
import pytest

from gateway.model.control_state import NcState
from gateway.model.standing import Standing
from gateway.telemetry import keys
from gateway.telemetry.codec import MESSAGE_TYPES
from gateway.telemetry.json_schema import schemas

PAGE = (Path(__file__).parents[3] / "docs" / "keys.md").read_text(encoding="utf-8")


def table() -> dict[str, set[str]]:
    """Kind of key to the fields that its row names in backticks."""
    rows = re.findall(r"^\| `(\w+)[^`]*` \| (.*) \|$", PAGE, re.MULTILINE)
    return {kind: set(re.findall(r"`(\w+)`", payload)) for kind, payload in rows}


@pytest.mark.parametrize(
    ("before", "words"),
    [
        ("`standing` of a wanted measurement: ", Standing),
        ("the control (`nc`: ", NcState),
    ],
)
def test_the_table_has_every_word_of_a_field(before: str, words: type[StrEnum]) -> None:
    listed = PAGE.partition(before)[2]
    assert listed[: min(listed.index(end) for end in ";)")].split(", ") == [str(word) for word in words]


def test_the_page_lists_and_counts_the_keys_that_only_answer_queries() -> None:
    number, listed = re.findall(r"answers queries on (\w+) more keys\..*?\n\n((?:[- ] [^\n]*\n)+)", PAGE, re.DOTALL)[0]
    parts = {"command_terms", "command_request", "error"}
    answered = schemas().keys() - MESSAGE_TYPES.keys() - parts | {keys.SCHEMA}
    assert sorted(re.findall(r"^- `(\w+)", listed, re.MULTILINE)) == sorted(answered)
    assert number == ("four", "five", "six", "seven", "eight")[len(answered) - 4]


def test_the_table_has_every_key_and_every_field_that_is_published() -> None:
    common = {"boot", "seq", "time", "clock"}
    assert all(f"`{name}`" in PAGE.split("|")[0] for name in common)
    fields = {kind: {field.encode_name for field in msgspec.structs.fields(of)} for kind, of in MESSAGE_TYPES.items()}
    assert table() == {kind: names - common for kind, names in fields.items()} | {keys.ALIVE: set()}
