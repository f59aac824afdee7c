"""The reference of all keys, made from the sections: `python -m gateway.config.reference` prints it."""

import ast
import json
import sys
from collections.abc import Iterator, Mapping
from inspect import cleandoc, getsource
from itertools import pairwise
from textwrap import dedent

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema, ModelSchema

from gateway.config.model import GatewayConfig

_HEAD = """\
# Configuration

One TOML file describes one gateway. `python -m gateway.config.reference` generates this page from the program; a test
fails when it is out of date. Unknown keys are errors, and types are strict: `"9600"` is not `9600`. Relative paths
start at the folder of the file. `talc-gateway check FILE` reads it, checks every device without using the network, and
reports every mistake with file, field, value and what is expected.

A fingerprint identifies the configuration in use: SHA-256 of the configuration with all defaults written out, so
comments and layout do not matter and a changed default does. It includes the files of your own profiles, the DBC files
that they name, and the file of `[talc] prior`. The key `status` publishes it as `config`. The database keeps each one
with its time.

**Reload.** On SIGHUP `talc-gateway run` reads its file again. It checks the whole file first. Then it closes and
reopens only the buses that changed (themselves, their devices, the files of your own profiles, or the limits of their
channels); the others keep their period. Changes to anything that the models and the NC depend on need a restart: the
names and order of the channels, `[machine]`, `[grid]`, `[storage]`, `[telemetry]`, `[metrics]`, `[[state]]`,
`[[planned_load]]`, `[nc]`, `[probing]`, `[compensation]`, `[talc]`, the file of its `prior`, and `[sensor_check]`. A
file that cannot be applied, or checked within 30 s, 10 s of processor time and 300 MB, changes nothing; the log says
why.
"""


class _Described(GenerateJsonSchema):
    """The text under each field of a section is its description."""

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        return _described(super().model_schema(schema), schema["cls"])

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        return _described(super().dataclass_schema(schema), schema["cls"])


def _described(table: JsonSchemaValue, section: type) -> JsonSchemaValue:
    fields = getattr(section, "__pydantic_fields__", {})
    for owner in reversed(section.__mro__):
        for name, text in _texts(owner):
            key = (fields[name].alias if name in fields else None) or name
            if key in table.get("properties", {}):
                table["properties"][key]["description"] = text
    return table


def _texts(owner: type) -> Iterator[tuple[str, str]]:
    """Names of a class's own fields, and the text under each."""
    if not getattr(owner, "__annotations__", None) or owner.__module__.startswith("pydantic"):
        return
    try:
        (made,) = ast.parse(dedent(getsource(owner))).body
    except OSError:
        return  # made by a program, with descriptions
    for field, below in pairwise(made.body if isinstance(made, ast.ClassDef) else ()):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
            match below.value:
                case ast.Constant(str(text)):
                    yield field.target.id, cleandoc(text)


def reference() -> str:
    """The whole page as Markdown."""
    schema = GatewayConfig.model_json_schema(by_alias=True, schema_generator=_Described)
    definitions: Mapping[str, Mapping[str, object]] = schema["$defs"]
    return "\n".join([_HEAD, *_tables("", schema, definitions)])


def _tables(path: str, table: Mapping[str, object], definitions: Mapping[str, Mapping[str, object]]) -> Iterator[str]:
    properties = table.get("properties")
    if not isinstance(properties, dict):
        return
    required = table.get("required")
    names = set(required) if isinstance(required, list) else set()
    rows, below = [], []
    for key, field in properties.items():
        here = f"{path}.{key}".removeprefix(".")
        members = list(_members(field, definitions))
        if members:
            listed = field.get("type") == "array"
            mapped = field.get("type") == "object"
            for member in members:
                title = f"[[{here}]]" if listed else f"[{here}.<name>]" if mapped else f"[{here}]"
                below.append((title, here, member))
        else:
            rows.append(
                f"| `{key}` | {_type(field)} | {_default(key, field, names)} | {_cell(field.get('description'))} |"
            )
    if rows:
        yield from ("| key | type | default | meaning |", "|---|---|---|---|", *rows, "")
    for title, here, member in below:
        kind = _kind(member)
        yield f"## `{title}`" + (f" of kind `{kind}`" if kind else "")
        yield ""
        yield from (str(member.get("description", "")), "")
        yield from _tables(here, member, definitions)


def _members(
    field: Mapping[str, object], definitions: Mapping[str, Mapping[str, object]]
) -> Iterator[Mapping[str, object]]:
    """The sections that a field can hold."""
    for holder in (field, field.get("items"), field.get("additionalProperties")):
        if not isinstance(holder, dict):
            continue
        if "$ref" in holder:
            found = definitions[str(holder["$ref"]).rsplit("/", 1)[-1]]
            if "properties" in found:  # otherwise one of several words
                yield found
        for choice in (c for union in ("anyOf", "oneOf", "allOf") for c in holder.get(union, ())):
            yield from _members(choice, definitions)


def _kind(section: Mapping[str, object]) -> str | None:
    properties = section.get("properties")
    kind = properties.get("kind") if isinstance(properties, dict) else None
    return str(kind["const"]) if isinstance(kind, dict) and "const" in kind else None


def _type(field: Mapping[str, object]) -> str:
    choices = field.get("anyOf")
    if isinstance(choices, list):
        return " or ".join(_type(choice) for choice in choices if choice.get("type") != "null")
    if "enum" in field or "const" in field:
        values = field.get("enum", [field.get("const")])
        return ", ".join(f"`{value}`" for value in values) if isinstance(values, list) else ""
    words = {"string": "text", "integer": "whole number", "number": "number", "boolean": "true or false"}
    words |= {"array": "list", "object": "table"}
    limits = {"exclusiveMinimum": "> {}", "minimum": "≥ {}", "maximum": "≤ {}", "exclusiveMaximum": "< {}"}
    bounds = [text.format(field[name]) for name, text in limits.items() if name in field]
    return " ".join([words.get(str(field.get("type")), ""), ", ".join(bounds)]).strip()


def _default(key: str, field: Mapping[str, object], required: set[str]) -> str:
    if key in required:
        return "required"
    value = field.get("default")
    if value is None:
        return "none"
    return f"`{json.dumps(value)}`"


def _cell(text: object) -> str:
    return " ".join(str(text or "").split()).replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(reference())
