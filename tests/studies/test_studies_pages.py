"""The studies' kept pages: they can be drawn, show the run of the results, and say the version of its learner."""

import csv
import json
import re
from pathlib import Path

import pytest
from markupsafe import escape

from studies import published_page

DOCS = Path(__file__).parents[2] / "docs"
KEPT = sorted((DOCS / "studies").iterdir())


def words(file: str) -> str:
    """A page's text with single spaces."""
    return " ".join((DOCS / file).read_text(encoding="utf-8").split())


def block(study: str) -> str:
    """What `make study` puts into the results, and the sentence or two before it."""
    before, _, rest = words("results.md").partition(f"<!-- study {study} -->")
    return before[-900:] + rest.partition("<!-- end -->")[0]


@pytest.mark.slow
@pytest.mark.parametrize("folder", KEPT, ids=[folder.name for folder in KEPT])
def test_every_kept_figure_is_on_the_page(folder: Path) -> None:
    page = published_page(folder)
    pictures = [file for file in folder.glob("*.csv") if not file.stem.endswith(("table", "summary"))]
    assert page.count("<svg") == len(pictures) > 0
    for file in set(folder.glob("*.csv")) - set(pictures):
        with file.open(newline="", encoding="utf-8") as opened:
            for row in csv.reader(opened):
                assert all(escape(cell) in page for cell in row[1:])


@pytest.mark.parametrize("folder", KEPT, ids=[folder.name for folder in KEPT])
def test_page_results_and_summary_show_one_run(folder: Path) -> None:
    study = folder.name
    code = json.loads((folder / "page.json").read_text(encoding="utf-8"))["origin"]["code"]
    assert f"code {code}," in block(study)
    (row,) = re.findall(rf"\| `{study}` \| ([^|]*) \| [^|]* \|", words("studies.md").partition("What has been run")[2])
    assert f"code {code};" in row


def test_no_page_is_said_to_show_a_part_of_what_was_run_in_full() -> None:
    before, _, rows = words("studies.md").partition("What has been run")
    partly = re.findall(r"\[([a-z-]+)\]\(studies/[a-z-]+\) with \d+ of its", before)
    assert not [study for study in partly if re.search(rf"\| `{study}` \| all ", rows)]
