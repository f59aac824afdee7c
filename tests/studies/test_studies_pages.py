"""The built pages of the studies: the run that they show, and whose learner it was."""

import re
from pathlib import Path

import pytest

from talc.learner.experts import EXPERTS

DOCS = Path(__file__).parents[2] / "docs"
BUILT = sorted(file.stem for file in (DOCS / "studies").glob("*.html"))
NUMBERS = {7: "seven", 8: "eight", 9: "nine", 10: "ten", 11: "eleven", 12: "twelve"}
FORMER = "The learner's figures on this page are those of its former "
"""How a page's note begins that says that the learner has changed since."""


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


def test_pages_made_with_an_earlier_learner_say_so() -> None:
    said = re.search(
        r"The learner's figures in the tables of (.*?) are those of its former (\w+) filters, the others those of the "
        r"present (\w+)\.",
        words("studies.md"),
    )
    assert said is not None
    former = re.findall(r"`([\w-]+)`", said[1])
    assert said[3] == NUMBERS[len(EXPERTS)], "which studies were run with the filters that the learner has now?"
    note = f"{FORMER}{said[2]} filters; it now has {said[3]}"
    found = {study for study in BUILT if note in words(f"studies/{study}.html")}
    assert found == set(former), "a page says so below its title; one that was made again does not"
    assert {study for study in BUILT if f"former {said[2]} filters" in block(study)} == set(former)
