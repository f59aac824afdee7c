"""Asks for the known vulnerabilities of what locks install, and names what could not be checked.

python deploy/advisories.py LOCK... [--index URL] [--longest SECONDS]

It asks PyPI's JSON for each distribution in its locked version. An index may report only the newest version: that is an
answer only where the newest version is the locked one. A question without an answer is asked three times, while there
is time. The last line sums up the result. Exit code 1: a vulnerability is known; 3: none is known, but not everything
could be checked.
"""

import argparse
import json
import re
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

INDEX = "https://pypi.org/pypi"
TIMEOUT_S, LONGEST_S = 20.0, 100.0
"""The time limits of one question, and of all together."""
PAUSES_S = (1.0, 4.0)
"""The pauses before the second and the third attempt at a question."""
AT_ONCE = 8
FOUND, UNCHECKED = 1, 3
"""Exit codes."""


@dataclass(frozen=True, slots=True)
class IndexAnswer:
    """What is known of one locked version."""

    name: str
    version: str
    advisories: tuple[str, ...] = ()
    unchecked: str = ""
    """Why nothing is known; empty: the advisories are all that there are."""


def locked(lines: Iterable[str]) -> set[tuple[str, str]]:
    """Name and version of everything in a lock, for whichever Python and computer."""
    found = (re.match(r"([A-Za-z0-9._-]+)==([^\s;\\]+)", line) for line in lines)
    return {(match[1], match[2]) for match in found if match}


def page(url: str, until_s: float) -> Any:
    """What an address serves as JSON; None if it serves nothing. until_s: of the monotonic clock.

    Raises
    ------
    OSError, ValueError: no answer, or none that can be read, three times or until then
    """
    pauses_s = list(PAUSES_S)
    while True:
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError("no time was left to ask")
        try:
            with urlopen(url, timeout=min(TIMEOUT_S, left_s)) as answer:
                return json.load(answer)
        except (OSError, ValueError) as error:
            if isinstance(error, HTTPError) and error.code == 404:
                return None
            if not pauses_s:
                raise
            time.sleep(max(0.0, min(pauses_s.pop(0), until_s - time.monotonic())))


def stated(about: Any) -> tuple[str, ...]:
    """The advisories of an answer, each with its aliases and the versions that fix it; without those withdrawn.

    Raises
    ------
    KeyError, TypeError: the answer has no list of them
    """
    return tuple(
        f"{one['id']} ({', '.join(one.get('aliases') or ['no other name'])}), "
        f"fixed in {', '.join(one.get('fixed_in') or ['no version'])}"
        for one in about["vulnerabilities"]
        if not one.get("withdrawn")
    )


def asked(index: str, name: str, version: str, until_s: float) -> IndexAnswer:
    """The index's answer about one version."""
    try:
        about = page(f"{index}/{name}/{version}/json", until_s)
        if about is None and (about := page(f"{index}/{name}/json", until_s)) is None:
            return IndexAnswer(name, version, unchecked="the index does not have it")
        told = about["info"]["version"]
        if told != version:
            return IndexAnswer(name, version, unchecked=f"the index reports only {told}")
        return IndexAnswer(name, version, stated(about))
    except (OSError, ValueError) as error:
        return IndexAnswer(name, version, unchecked=str(error) or type(error).__name__)
    except (KeyError, TypeError):
        return IndexAnswer(name, version, unchecked="the index's answer has no advisories in it")


def in_short(answers: list[IndexAnswer]) -> str:
    """One line."""
    bad = [one for one in answers if one.advisories]
    unchecked = [f"{one.name} {one.version} ({one.unchecked})" for one in answers if one.unchecked]
    if len(unchecked) == len(answers):
        return f"NOT CHECKED: none of {len(answers)} locked versions, such as {', '.join(unchecked[:1])}"
    checked = len(answers) - len(unchecked)
    found = f"{sum(len(one.advisories) for one in bad)} in {', '.join(f'{one.name} {one.version}' for one in bad)}"
    left = f"; NOT CHECKED: {', '.join(unchecked)}" if unchecked else ""
    return f"{found if bad else 'none'}; checked {checked} of {len(answers)} locked versions{left}"


def main() -> None:
    """Ask, and print."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("locks", nargs="+", type=Path, metavar="LOCK")
    arguments.add_argument("--index", default=INDEX, metavar="URL")
    arguments.add_argument("--longest", type=float, default=LONGEST_S, metavar="SECONDS")
    given = arguments.parse_args()
    until_s = time.monotonic() + given.longest
    wanted = sorted({one for lock in given.locks for one in locked(lock.read_text(encoding="utf-8").splitlines())})
    with ThreadPoolExecutor(AT_ONCE) as pool:
        answers = list(pool.map(lambda one: asked(given.index, *one, until_s), wanted))
    for answer in answers:
        for advisory in answer.advisories:
            print(f"{answer.name} {answer.version}: {advisory}")
    print(in_short(answers))
    if any(answer.advisories for answer in answers):
        sys.exit(FOUND)
    sys.exit(UNCHECKED if any(answer.unchecked for answer in answers) else 0)


if __name__ == "__main__":
    main()
