"""`python -m benchmarks [SUBJECT ...]`: run, print, and renew the table in README.md when all subjects ran."""

import importlib
import os
import re
import sys
from pathlib import Path

_SUBJECTS = ("group_lasso", "selection", "footprint", "unseen_days")
_README = Path(__file__).parents[1] / "README.md"
_BLOCK = re.compile(r"(<!-- benchmarks -->\n).*?(<!-- /benchmarks -->)", re.DOTALL)


def main(wanted: list[str]) -> None:
    unknown = set(wanted) - set(_SUBJECTS)
    if unknown:
        raise SystemExit(f"no such subject: {', '.join(sorted(unknown))}; there are {', '.join(_SUBJECTS)}")
    lines = ["| work | here | peer | goal |", "|---|---|---|---|"]
    for subject in wanted or _SUBJECTS:
        for row in importlib.import_module(f"benchmarks.{subject}").rows():
            lines.append(f"| {row.work} | {row.ours} | {row.peer} | {row.goal} |")
            print(lines[-1], flush=True)
    if not wanted:
        text = _README.read_text(encoding="utf-8")
        table = "\n".join(lines) + "\n"
        _README.write_text(_BLOCK.sub(lambda m: m[1] + table + m[2], text), encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(sys.argv[1:])
