"""`python -m benchmarks [SUBJECT ...]`: run, print, and renew the subjects' tables in README.md."""

import importlib
import os
import re
import sys
from pathlib import Path

_SUBJECTS = ("group_lasso", "selection", "footprint", "unseen_days")
_README = Path(__file__).parents[1] / "README.md"


def main(wanted: list[str]) -> None:
    unknown = set(wanted) - set(_SUBJECTS)
    if unknown:
        raise SystemExit(f"no such subject: {', '.join(sorted(unknown))}; there are {', '.join(_SUBJECTS)}")
    for subject in wanted or _SUBJECTS:
        lines = ["| work | here | beside it | goal |", "|---|---|---|---|"]
        for row in importlib.import_module(f"benchmarks.{subject}").rows():
            lines.append(f"| {row.work} | {row.ours} | {row.peer} | {row.goal} |")
        table = "\n".join(lines) + "\n"
        print(table, flush=True)
        block = re.compile(rf"(<!-- benchmark {subject} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = _README.read_text(encoding="utf-8")
        _README.write_text(block.sub(lambda m, t=table: m[1] + t + m[2], text), encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(sys.argv[1:])
