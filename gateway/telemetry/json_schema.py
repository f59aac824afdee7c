"""JSON Schemas of everything that is published, generated from the types."""

import json

import msgspec

from gateway.telemetry.messages import TYPES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """File name to text, one per kind of key."""
    return {f"{kind}.schema.json": _text(kind) for kind in TYPES}


def _text(kind: str) -> str:
    schema = {"$schema": _DIALECT, **msgspec.json.schema(TYPES[kind])}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
