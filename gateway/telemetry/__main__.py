"""`python -m gateway.telemetry FOLDER`: writes the JSON Schemas of everything that is published."""

import sys
from pathlib import Path

from gateway.telemetry.json_schema import schemas


def main(folder: Path) -> None:
    """One file per kind of key."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind, text in schemas().items():
        (folder / f"{kind}.schema.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m gateway.telemetry FOLDER")
    main(Path(sys.argv[1]))
