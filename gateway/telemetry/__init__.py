"""Telemetry: the messages that are published over Zenoh, and their keys.

`NcState`, `Source` and `Standing` are the texts of some fields, for programs that only read messages.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.nc import NcState, Source
    from gateway.probing import Standing
    from gateway.telemetry import keys
    from gateway.telemetry.answers import (
        CommandAnswer,
        CommandRequest,
        CommandTerms,
        CoursePage,
        HistoryBlock,
        HistoryPage,
        ReportPage,
        StoredColumn,
        StoredReason,
        StoredRows,
        StoredTable,
    )
    from gateway.telemetry.asking import COMMAND_LIMIT_S, QueryRefusal, SeveralAnswer, ask, ask_only, command, running
    from gateway.telemetry.codec import MESSAGE_TYPES, decode, decode_answer, encode
    from gateway.telemetry.command_door import CommandDoor, Entitled
    from gateway.telemetry.command_signer import CommandSigner, SignedCommand
    from gateway.telemetry.compose import Composer, reason_of_each
    from gateway.telemetry.fields import text_from, texts_from
    from gateway.telemetry.history_queries import CourseRequest, CourseSource, HistoryRequest, HistorySource
    from gateway.telemetry.messages import (
        CompensationMessage,
        DecisionMessage,
        EventMessage,
        ForecastMessage,
        FrameMessage,
        MeasurementMessage,
        ModelMessage,
        PauseStanding,
        ProbingMessage,
        ProbingStanding,
        Published,
        PublishedCourse,
        PublishedReason,
        ReadingMessage,
        ReasonsMessage,
        SensorFinding,
        SensorsMessage,
        StatusMessage,
        StorageStanding,
    )
    from gateway.telemetry.numbers import by_error, courses, finite
    from gateway.telemetry.publisher import TelemetryPublisher
    from gateway.telemetry.queries import MOST_ROWS, AskedQuery
    from gateway.telemetry.report_queries import ReportRequest
    from gateway.telemetry.session import (
        Access,
        TelemetryError,
        own_access,
        page_config,
        reader_config,
        reading_session,
    )
    from gateway.telemetry.stored_queries import StoredRequest, StoredSource
else:
    __getattr__ = on_first_use(
        __name__,
        {
            "gateway.nc": ("NcState", "Source"),
            "gateway.probing": ("Standing",),
            ".answers": (
                "CommandAnswer",
                "CommandRequest",
                "CommandTerms",
                "CoursePage",
                "HistoryBlock",
                "HistoryPage",
                "ReportPage",
                "StoredColumn",
                "StoredReason",
                "StoredRows",
                "StoredTable",
            ),
            ".asking": ("COMMAND_LIMIT_S", "QueryRefusal", "SeveralAnswer", "ask", "ask_only", "command", "running"),
            ".codec": ("MESSAGE_TYPES", "decode", "decode_answer", "encode"),
            ".command_door": ("CommandDoor", "Entitled"),
            ".command_signer": ("CommandSigner", "SignedCommand"),
            ".compose": ("Composer", "reason_of_each"),
            ".fields": ("text_from", "texts_from"),
            ".history_queries": ("CourseRequest", "CourseSource", "HistoryRequest", "HistorySource"),
            ".keys": (),
            ".messages": (
                "CompensationMessage",
                "DecisionMessage",
                "EventMessage",
                "ForecastMessage",
                "FrameMessage",
                "MeasurementMessage",
                "ModelMessage",
                "PauseStanding",
                "ProbingMessage",
                "ProbingStanding",
                "Published",
                "PublishedCourse",
                "PublishedReason",
                "ReadingMessage",
                "ReasonsMessage",
                "SensorFinding",
                "SensorsMessage",
                "StatusMessage",
                "StorageStanding",
            ),
            ".numbers": ("by_error", "courses", "finite"),
            ".publisher": ("TelemetryPublisher",),
            ".queries": ("MOST_ROWS", "AskedQuery"),
            ".report_queries": ("ReportRequest",),
            ".session": (
                "Access",
                "TelemetryError",
                "own_access",
                "page_config",
                "reader_config",
                "reading_session",
            ),
            ".stored_queries": ("StoredRequest", "StoredSource"),
        },
    )

__all__ = [
    "COMMAND_LIMIT_S",
    "MESSAGE_TYPES",
    "MOST_ROWS",
    "Access",
    "AskedQuery",
    "CommandAnswer",
    "CommandDoor",
    "CommandRequest",
    "CommandSigner",
    "CommandTerms",
    "CompensationMessage",
    "Composer",
    "CoursePage",
    "CourseRequest",
    "CourseSource",
    "DecisionMessage",
    "Entitled",
    "EventMessage",
    "ForecastMessage",
    "FrameMessage",
    "HistoryBlock",
    "HistoryPage",
    "HistoryRequest",
    "HistorySource",
    "MeasurementMessage",
    "ModelMessage",
    "NcState",
    "PauseStanding",
    "ProbingMessage",
    "ProbingStanding",
    "Published",
    "PublishedCourse",
    "PublishedReason",
    "QueryRefusal",
    "ReadingMessage",
    "ReasonsMessage",
    "ReportPage",
    "ReportRequest",
    "SensorFinding",
    "SensorsMessage",
    "SeveralAnswer",
    "SignedCommand",
    "Source",
    "Standing",
    "StatusMessage",
    "StorageStanding",
    "StoredColumn",
    "StoredReason",
    "StoredRequest",
    "StoredRows",
    "StoredSource",
    "StoredTable",
    "TelemetryError",
    "TelemetryPublisher",
    "ask",
    "ask_only",
    "by_error",
    "command",
    "courses",
    "decode",
    "decode_answer",
    "encode",
    "finite",
    "keys",
    "own_access",
    "page_config",
    "reader_config",
    "reading_session",
    "reason_of_each",
    "running",
    "text_from",
    "texts_from",
]
