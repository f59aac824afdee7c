"""The check for known vulnerabilities: what an index answers, what it does not, and what is reported about the rest."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from tests.benches.free_port import free_port

ROOT = Path(__file__).parents[1]
LOCK = """\
# a comment with other==1.0 in it
one==1.0 \\
    --hash=sha256:00 \\
    # via two==9.9
Two.2==2.0 ; python_full_version < '3.12' \\
    --hash=sha256:00
"""
KNOWN = {"id": "PYSEC-1", "aliases": ["CVE-1"], "fixed_in": ["1.1"], "withdrawn": None}


def of(version: str, *advisories: dict[str, Any]) -> bytes:
    return json.dumps({"info": {"version": version}, "vulnerabilities": advisories}).encode()


@contextmanager
def index(pages: dict[str, bytes], *, refused: int = 0) -> Iterator[str]:
    """An index with these pages; each address is refused this many times before."""
    times: dict[str, int] = {}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            times[self.path] = times.get(self.path, 0) + 1
            status = 503 if times[self.path] <= refused else 200 if self.path in pages else 404
            self.send_response(status)
            self.end_headers()
            self.wfile.write(pages.get(self.path, b"") if status == 200 else b"")

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def audited(folder: Path, url: str, *more: str) -> tuple[int, list[str]]:
    """Exit code and lines."""
    lock = folder / "run.lock"
    lock.write_text(LOCK, encoding="utf-8")
    command = [sys.executable, str(ROOT / "deploy" / "advisories.py"), str(lock), "--index", url, *more]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.returncode, done.stdout.splitlines()


def test_nothing_is_known_of_any_version(tmp_path: Path) -> None:
    withdrawn = {**KNOWN, "withdrawn": "2026-01-01T00:00:00Z"}
    with index({"/one/1.0/json": of("1.0"), "/Two.2/2.0/json": of("2.0", withdrawn)}) as url:
        assert audited(tmp_path, url) == (0, ["none; checked 2 of 2 locked versions"])


def test_an_advisory_is_shown_with_its_aliases_and_what_mends_it(tmp_path: Path) -> None:
    with index({"/one/1.0/json": of("1.0", KNOWN), "/Two.2/2.0/json": of("2.0", {"id": "GHSA-2"})}) as url:
        code, lines = audited(tmp_path, url)
    assert code == 1
    assert lines == [
        "Two.2 2.0: GHSA-2 (no other name), fixed in no version",
        "one 1.0: PYSEC-1 (CVE-1), fixed in 1.1",
        "2 in Two.2 2.0, one 1.0; checked 2 of 2 locked versions",
    ]


def test_an_index_that_reports_only_the_newest_version_answers_for_that_one(tmp_path: Path) -> None:
    with index({"/one/json": of("1.0", KNOWN), "/Two.2/json": of("3.0")}) as url:
        code, lines = audited(tmp_path, url)
    assert code == 1
    assert lines[0] == "one 1.0: PYSEC-1 (CVE-1), fixed in 1.1"
    assert lines[-1].startswith("1 in one 1.0; checked 1 of 2 locked versions; NOT CHECKED: ")
    assert lines[-1].endswith("NOT CHECKED: Two.2 2.0 (the index reports only 3.0)")


def test_an_index_that_refuses_once_is_asked_again(tmp_path: Path) -> None:
    with index({"/one/1.0/json": of("1.0"), "/Two.2/2.0/json": of("2.0")}, refused=1) as url:
        assert audited(tmp_path, url) == (0, ["none; checked 2 of 2 locked versions"])


def test_what_could_not_be_checked_is_named_beside_the_rest(tmp_path: Path) -> None:
    with index({"/one/1.0/json": of("1.0")}) as url:
        code, lines = audited(tmp_path, url)
    assert code == 3
    assert lines == ["none; checked 1 of 2 locked versions; NOT CHECKED: Two.2 2.0 (the index does not have it)"]


def test_an_answer_without_advisories_is_no_clean_bill(tmp_path: Path) -> None:
    with index({"/one/1.0/json": b'{"info": {"version": "1.0"}}', "/Two.2/2.0/json": of("2.0")}) as url:
        code, lines = audited(tmp_path, url)
    assert code == 3
    assert lines[-1].endswith("NOT CHECKED: one 1.0 (the index's answer has no advisories in it)")


def test_an_index_that_cannot_be_reached_is_no_clean_bill(tmp_path: Path) -> None:
    code, lines = audited(tmp_path, f"http://127.0.0.1:{free_port()}", "--longest", "0.5")
    assert code == 3
    assert lines == ["NOT CHECKED: none of 2 locked versions, such as Two.2 2.0 (no time was left to ask)"]
