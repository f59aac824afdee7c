"""JSON Schemas of everything that is published or answered, generated from the types."""

import json

import msgspec

from gateway.telemetry.codec import ANSWERS, MESSAGE_TYPES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """Kind of key to text: of everything that is published or answered."""
    return {kind: _schema_text(type_) for kind, type_ in (*MESSAGE_TYPES.items(), *ANSWERS.items())}


def _schema_text(type_: type[msgspec.Struct]) -> str:
    schema = {"$schema": _DIALECT, **msgspec.json.schema(type_)}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
