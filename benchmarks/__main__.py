"""`python -m benchmarks [SUBJECT ...]`: runs the subjects, prints their tables and renews them in docs/figures.md."""

import importlib
import os
import sys
from pathlib import Path

from benchmarks.rows import BenchRow

_SUBJECTS = (
    "demo",
    "demo_models",
    "demo_presets",
    "acquisition",
    "sensor_check",
    "group_lasso",
    "selection",
    "footprint",
    "storage",
    "unseen_days",
    "learner",
    "policy",
    "tolerance",
    "forecast",
    "faults",
    "recordings",
)
_ON_REQUEST = ("thingsboard",)
"""Subjects that install a third-party program, and therefore run only when they are named."""
_FIGURES = Path(__file__).parents[1] / "docs" / "figures.md"


def main(wanted: list[str], results: Path = _FIGURES) -> None:
    """Run the subjects, all of them if none is named, and renew their tables in a Markdown file."""
    available = (*_SUBJECTS, *_ON_REQUEST)
    unknown = set(wanted) - set(available)
    if unknown:
        raise SystemExit(f"no such subject: {', '.join(sorted(unknown))}; available: {', '.join(available)}")
    for subject in wanted or _SUBJECTS:
        module = importlib.import_module(f"benchmarks.{subject}")
        rows: list[BenchRow] = module.rows()
        lines = ["| work | here | beside it |", "|---|---|---|"]
        lines += [f"| {row.work} | {row.ours} | {row.peer} |" for row in rows]
        table = "\n".join(lines) + "\n"
        print(table, flush=True)
        if not getattr(module, "is_shipped", lambda: True)():
            continue  # figures of a user's own data
        head, begin, rest = results.read_text(encoding="utf-8").partition(f"<!-- benchmark {subject} -->\n")
        _, end, tail = rest.partition("<!-- end -->")
        if begin and end:
            results.write_text(head + begin + table + end + tail, encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(sys.argv[1:])
