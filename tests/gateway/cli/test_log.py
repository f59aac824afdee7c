"""The log: printable for a terminal, with priorities for the journal."""

import os
import subprocess
import sys
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, languages

PROGRAM = """
import logging
from gateway.runtime.log import log_to_stderr
log_to_stderr(logging.INFO)
log = logging.getLogger("gateway.nc")
log.info("started")
log.warning("alarm \\x1b[2J")
try:
    1 / 0
except ZeroDivisionError:
    log.exception("failed")
"""


SAYS = """
import logging
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.log import log_to_stderr
log_to_stderr(logging.INFO)
logging.getLogger("gateway.nc").warning("%s", Text(NoticeCode.CLOCK_SET, by_s=2.0))
"""


def test_it_is_in_the_language_of_the_environment() -> None:
    for language in languages():
        environment = {**os.environ, "LC_ALL": language, "JOURNAL_STREAM": ""}
        said = subprocess.run([sys.executable, "-c", SAYS], capture_output=True, check=True, env=environment).stderr
        assert said.decode().rstrip().endswith(Text(NoticeCode.CLOCK_SET, by_s=2.0).in_language(language))


def lines(folder: Path, journal: bool) -> list[str]:
    """What the program logs into a file, which is the journal's stream if the environment says so."""
    with (folder / "err").open("w+") as stream:
        status = os.fstat(stream.fileno())
        named = f"{status.st_dev}:{status.st_ino}" if journal else "0:1"
        subprocess.run(
            [sys.executable, "-c", PROGRAM], stderr=stream, check=True, env={**os.environ, "JOURNAL_STREAM": named}
        )
    return (folder / "err").read_text().splitlines()


def test_in_the_journal_each_line_has_its_priority_and_no_time(tmp_path: Path) -> None:
    found = lines(tmp_path, journal=True)
    assert found[:3] == ["<6>gateway.nc: started", "<4>gateway.nc: alarm �[2J", "<3>gateway.nc: failed"]
    assert "ZeroDivisionError" in found[-1]
    assert all(line.startswith("<3>") for line in found[3:])


def test_elsewhere_each_record_has_its_time_and_no_priority(tmp_path: Path) -> None:
    found = lines(tmp_path, journal=False)
    assert found[0].endswith("INFO gateway.nc: started")
    assert found[0][:4].isdecimal()
    assert found[1].endswith("WARNING gateway.nc: alarm �[2J")
