"""The published messages and the answers to queries as JSON: which type each kind of key has, and its coding."""

from collections.abc import Mapping
from typing import Any, Final, TypeVar, cast

import msgspec
from msgspec import Struct

from gateway.model.text import Text, json_text, plain
from gateway.telemetry import keys
from gateway.telemetry.answers import (
    CommandAnswer,
    CommandRequest,
    CommandTerms,
    CoursePage,
    HistoryPage,
    QueryRefused,
    ReportPage,
    ScenarioPage,
    StoredRows,
)
from gateway.telemetry.fields import text_from
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    ForecastMessage,
    FrameMessage,
    MeasurementMessage,
    ModelMessage,
    ProbingMessage,
    Published,
    ReadingMessage,
    ReasonsMessage,
    SensorsMessage,
    StatusMessage,
)

_Answer = TypeVar("_Answer", bound=Struct)

MESSAGE_TYPES: Final[Mapping[str, type[Published]]] = {
    keys.READING: ReadingMessage,
    keys.FRAME: FrameMessage,
    keys.DECISION: DecisionMessage,
    keys.MEASUREMENT: MeasurementMessage,
    keys.MODEL: ModelMessage,
    keys.EVENT: EventMessage,
    keys.COMPENSATION: CompensationMessage,
    keys.PROBING: ProbingMessage,
    keys.SENSORS: SensorsMessage,
    keys.REASONS: ReasonsMessage,
    keys.FORECAST: ForecastMessage,
    keys.STATUS: StatusMessage,
}
"""Type of each kind of key."""

ANSWERS: Final[Mapping[str, type[Struct]]] = {
    keys.COURSE: CoursePage,
    keys.HISTORY: HistoryPage,
    keys.REPORT: ReportPage,
    keys.SCENARIO: ScenarioPage,
    keys.STORED: StoredRows,
    keys.COMMAND: CommandAnswer,
    "command_terms": CommandTerms,
    "command_request": CommandRequest,
    "error": QueryRefused,
}
"""Type of what queries are answered with, by kind of key; `error`: every error reply. And what a command is made of."""

_UNDECODABLE = (msgspec.DecodeError, RecursionError)
"""The second: of brackets within brackets, also in a field that this version does not know."""

_ENCODER = msgspec.json.Encoder(enc_hook=json_text)
_DECODERS: Final[Mapping[type[Struct], msgspec.json.Decoder[Any]]] = {
    type_: msgspec.json.Decoder(type_) for type_ in (*MESSAGE_TYPES.values(), *ANSWERS.values())
}
"""Made before there are threads: msgspec crashes when one meets a type of which another is just finding the fields."""


def encode(
    message: Published
    | CoursePage
    | HistoryPage
    | ReportPage
    | ScenarioPage
    | StoredRows
    | CommandTerms
    | CommandRequest
    | CommandAnswer
    | QueryRefused,
) -> bytes:
    """JSON."""
    return _ENCODER.encode(message)


def decode_answer(answer: type[_Answer], payload: bytes) -> _Answer:
    """The answer to a query: one of `ANSWERS`, or the latest message.

    Raises ValueError naming type and field if the payload does not fit.
    """
    try:
        return cast("_Answer", _DECODERS[answer].decode(payload))
    except _UNDECODABLE as error:
        raise ValueError(f"{answer.__name__}: {error}") from error


def decode_refusal(payload: bytes) -> Text:
    """What an error reply says; the payload itself, if it is of another program."""
    try:
        refused = decode_answer(QueryRefused, payload)
    except ValueError:
        return plain(payload.decode(errors="replace"))
    return text_from(refused.error, refused.coded)


def decode(suffix: str, payload: bytes) -> Published | None:
    """The message under a key below the root; None: a kind of key that this version does not know.

    Raises ValueError naming key and field if the payload does not fit the type.
    """
    type_ = MESSAGE_TYPES.get(keys.kind_of(suffix))
    if type_ is None:
        return None
    try:
        return cast("Published", _DECODERS[type_].decode(payload))
    except _UNDECODABLE as error:
        raise ValueError(f"payload of {suffix}: {error}") from error
