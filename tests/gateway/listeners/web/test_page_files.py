"""The page's scripts and styles: all exist, and the browser keeps them for as long as the program has them."""

import re
import shutil
from importlib.resources import files
from pathlib import Path

from starlette.testclient import TestClient

from gateway.listeners.web.page_files import PageFiles
from tests.benches.mill_page import mill_page

GATEWAY = Path(str(files("gateway")))
SCRIPTS = sorted((GATEWAY / "listeners" / "web" / "static").glob("*.js"))


def named_files(page: TestClient) -> list[str]:
    """Addresses that the machine's page names."""
    return re.findall(r'(?:href|src)="(/file/[^"]+)"', page.get("/machine/mill").text)


def test_a_browser_keeps_each_file_of_this_version_and_no_page() -> None:
    page = mill_page()
    named = named_files(page)
    (entry,) = [file for file in named if file.endswith("/page.js")]
    imported = [f"{entry.rpartition('/')[0]}/{script.name}" for script in SCRIPTS]
    assert len(named) >= 5
    for file in {*named, *imported}:
        answer = page.get(file)
        assert answer.status_code == 200
        assert "immutable" in answer.headers["cache-control"], file
    for script in SCRIPTS:
        for other in re.findall(r'from "\./([\w.]+)"', script.read_text("utf-8")):
            answer = page.get(f"{entry.rpartition('/')[0]}/{other}")
            assert answer.headers["content-type"].startswith("text/javascript")
    assert page.get("/machine/mill").headers["cache-control"] == "no-store"
    plain, packed = (page.get(entry, headers={"accept-encoding": accepted}) for accepted in ("identity", "br, gzip"))
    assert (plain.headers.get("content-encoding"), packed.headers["content-encoding"]) == (None, "gzip")
    assert plain.content == packed.content == (SCRIPTS[0].parent / "page.js").read_bytes()


def test_a_first_visit_takes_at_most_250_kB() -> None:
    page = mill_page()
    named = named_files(page)
    folder = next(file for file in named if file.endswith("/page.js")).rpartition("/")[0]
    sizes = {
        file: int(page.get(file, headers={"accept-encoding": "gzip"}).headers["content-length"])
        for file in {"/machine/mill", *named, *(f"{folder}/{script.name}" for script in SCRIPTS)}
    }
    assert sum(sizes.values()) <= 250_000, sizes


def test_under_another_version_a_file_is_todays_and_is_not_kept() -> None:
    page = mill_page()
    now = next(file for file in named_files(page) if file.endswith("/page.css"))
    other = page.get("/file/0/page.css")
    assert other.text == page.get(now).text
    assert other.headers["cache-control"] == "no-store"
    assert page.get(now.replace("page.css", "access.py")).status_code == 404


def test_another_file_is_another_version_and_what_runs_keeps_its_own(tmp_path: Path) -> None:
    for folder in ("listeners/web/static", "reporting/uplot"):
        shutil.copytree(GATEWAY / folder, tmp_path / folder)
    before = PageFiles(tmp_path)
    folder = before.folder
    assert PageFiles(tmp_path).folder == folder
    with (tmp_path / "listeners/web/static/words.js").open("a", encoding="utf-8") as script:
        script.write("// changed\n")
    assert PageFiles(tmp_path).folder != folder
    assert before.folder == folder
