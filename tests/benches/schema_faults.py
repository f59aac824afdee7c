"""Checks JSON against a JSON Schema, without the types and the library that make the schemas of the key space.

Knows the keywords that docs/telemetry uses; another one is an error, not passed over.
"""

import base64
from datetime import datetime
from typing import Any

_TYPES: dict[str, tuple[type, ...]] = {
    "null": (type(None),),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "string": (str,),
    "array": (list,),
    "object": (dict,),
}
_SILENT = {"title", "description", "default", "examples", "$schema", "$defs", "prefixItems", "required"}
"""Say nothing about a value, or are looked at with another keyword."""


def schema_faults(value: Any, schema: dict[str, Any], at: str = "$", whole: dict[str, Any] | None = None) -> list[str]:
    """What in a value contradicts the schema, each with its place; empty: it fits."""
    whole = schema if whole is None else whole
    found: list[str] = []
    for word, wanted in schema.items():
        match word:
            case "$ref":
                found += schema_faults(value, whole["$defs"][wanted.rpartition("/")[2]], at, whole)
            case "anyOf":
                if all(schema_faults(value, one, at, whole) for one in wanted):
                    found.append(f"{at}: {value!r} is none of {wanted}")
            case "type":
                of_type = isinstance(value, _TYPES[wanted]) and (wanted == "boolean" or not isinstance(value, bool))
                found += [] if of_type else [f"{at}: {value!r} is no {wanted}"]
            case _ if word in _SILENT:
                pass
            case _:
                found += _faults_of(word, value, schema, at, whole)
    return found


def _faults_of(word: str, value: Any, schema: dict[str, Any], at: str, whole: dict[str, Any]) -> list[str]:
    wanted = schema[word]
    match word, value:
        case "properties", dict():
            missing = [f"{at}: {name} is missing" for name in schema.get("required", ()) if name not in value]
            inside = [schema_faults(value[n], s, f"{at}.{n}", whole) for n, s in wanted.items() if n in value]
            return [*missing, *(fault for faults in inside for fault in faults)]
        case "additionalProperties", dict() if isinstance(wanted, dict):
            others = [name for name in value if name not in schema.get("properties", ())]
            return [f for name in others for f in schema_faults(value[name], wanted, f"{at}.{name}", whole)]
        case "items", list():
            first = schema.get("prefixItems", ())
            kinds = [*first, *[wanted] * (len(value) - len(first))] if isinstance(wanted, dict) else first
            each = zip(value, kinds, strict=False)
            return [f for n, (one, kind) in enumerate(each) for f in schema_faults(one, kind, f"{at}[{n}]", whole)]
        case ("minItems", list()) | ("minLength", str()):
            return [] if len(value) >= wanted else [f"{at}: has {len(value)}, at least {wanted} are expected"]
        case ("maxItems", list()) | ("maxLength", str()):
            return [] if len(value) <= wanted else [f"{at}: has {len(value)}, at most {wanted} are expected"]
        case "minimum", int() | float():
            return [] if value >= wanted else [f"{at}: {value} is less than {wanted}"]
        case (("format" | "contentEncoding"), str()):
            return [] if _READERS[wanted](value) else [f"{at}: {value!r} is no {wanted}"]
        case (
            ("properties" | "additionalProperties" | "items" | "minItems" | "maxItems" | "minLength" | "maxLength"),
            _,
        ):
            return []
        case (("minimum" | "format" | "contentEncoding"), _):
            return []
    raise ValueError(f"{at}: {word}: a keyword that is not known here")


def _is_time(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _is_base64(text: str) -> bool:
    try:
        return bool(base64.b64decode(text, validate=True))
    except ValueError:
        return False


_READERS = {"date-time": _is_time, "base64": _is_base64}
