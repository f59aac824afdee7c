"""JSON Schemas of everything that is published; `python -m gateway.telemetry.schemas FOLDER` writes them."""

import json
import sys
from pathlib import Path

import msgspec

from gateway.telemetry.messages import TYPES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """File name to text, one per kind of key."""
    return {f"{kind}.schema.json": _text(kind) for kind in TYPES}


def _text(kind: str) -> str:
    schema = {"$schema": _DIALECT, **msgspec.json.schema(TYPES[kind])}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def main(folder: Path) -> None:
    """Write all; files of kinds that are gone stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in schemas().items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
