"""The built pages of the studies: the run that they show, and the version of its learner."""

import re
from pathlib import Path

import pytest

from talc.learner.experts import EXPERTS

DOCS = Path(__file__).parents[2] / "docs"
BUILT = sorted(file.stem for file in (DOCS / "studies").glob("*.html"))
NUMBERS = {7: "seven", 8: "eight", 9: "nine", 10: "ten", 11: "eleven", 12: "twelve"}


def words(file: str) -> str:
    """A page's text with single spaces."""
    return " ".join((DOCS / file).read_text(encoding="utf-8").split())


def block(study: str) -> str:
    """What `make study` puts into the results, and the sentence or two before it."""
    before, _, rest = words("results.md").partition(f"<!-- study {study} -->")
    return before[-900:] + rest.partition("<!-- end -->")[0]


@pytest.mark.parametrize("study", BUILT)
def test_page_results_and_summary_show_one_run(study: str) -> None:
    page = (DOCS / "studies" / f"{study}.html").read_text(encoding="utf-8")
    (code,) = set(re.findall(r"; code ([0-9a-f]{8})\.<br>", page))
    assert f"code {code}," in block(study)
    (row,) = re.findall(rf"\| `{study}` \| ([^|]*) \| [^|]* \|", words("studies.md").partition("What has been run")[2])
    assert f"code {code};" in row


def test_no_page_is_said_to_show_a_part_of_what_was_run_in_full() -> None:
    before, _, rows = words("studies.md").partition("What has been run")
    partly = re.findall(r"\[([a-z-]+)\]\(studies/[a-z-]+\.html\) with \d+ of its", before)
    assert not [study for study in partly if re.search(rf"\| `{study}` \| all ", rows)]


def test_every_page_was_made_with_the_learner_of_today() -> None:
    said = re.search(r"In every table the learner has its present (\w+) filters\.", words("studies.md"))
    assert said is not None
    assert said[1] == NUMBERS[len(EXPERTS)], "which studies were run with the filters that the learner has now?"
