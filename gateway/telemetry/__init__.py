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
    from gateway.telemetry.asking import COMMAND_LIMIT_S, SeveralAnswer, ask, ask_only, command, running
    from gateway.telemetry.codec import MESSAGE_TYPES, decode, decode_answer, decode_refusal, encode
    from gateway.telemetry.command_door import CommandDoor, Entitled
    from gateway.telemetry.command_signer import CommandSigner, SignedCommand
    from gateway.telemetry.compose import Composer, Dropped, reason_of_each
    from gateway.telemetry.history_queries import CourseRequest, CourseSource, HistoryRequest, HistorySource
    from gateway.telemetry.json_schema import schemas
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
    from gateway.telemetry.numbers import courses
    from gateway.telemetry.publisher import TelemetryPublisher
    from gateway.telemetry.queries import MOST_ROWS, AskedQuery, Replied
    from gateway.telemetry.report_queries import ReportRequest, ReportSource
    from gateway.telemetry.session import (
        Access,
        TelemetryError,
        own_access,
        page_config,
        reader_config,
        reading_session,
        without_path,
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
            ".asking": ("COMMAND_LIMIT_S", "SeveralAnswer", "ask", "ask_only", "command", "running"),
            ".codec": ("MESSAGE_TYPES", "decode", "decode_answer", "decode_refusal", "encode"),
            ".command_door": ("CommandDoor", "Entitled"),
            ".command_signer": ("CommandSigner", "SignedCommand"),
            ".compose": ("Composer", "Dropped", "reason_of_each"),
            ".history_queries": ("CourseRequest", "CourseSource", "HistoryRequest", "HistorySource"),
            ".json_schema": ("schemas",),
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
            ".numbers": ("courses",),
            ".publisher": ("TelemetryPublisher",),
            ".queries": ("MOST_ROWS", "AskedQuery", "Replied"),
            ".report_queries": ("ReportRequest", "ReportSource"),
            ".session": (
                "Access",
                "TelemetryError",
                "own_access",
                "page_config",
                "reader_config",
                "reading_session",
                "without_path",
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
    "Dropped",
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
    "ReadingMessage",
    "ReasonsMessage",
    "Replied",
    "ReportPage",
    "ReportRequest",
    "ReportSource",
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
    "command",
    "courses",
    "decode",
    "decode_answer",
    "decode_refusal",
    "encode",
    "keys",
    "own_access",
    "page_config",
    "reader_config",
    "reading_session",
    "reason_of_each",
    "running",
    "schemas",
    "without_path",
]
