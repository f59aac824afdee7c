"""Outlets of other packages: they are used like the gateway's own, and a broken one is reported in one line."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.listeners.outlets.settings import load_outlets
from tests.benches.extension_package import files_of, install
from tests.benches.feed_talk import heard

pytestmark = pytest.mark.usefixtures("no_package_stays_loaded")

LINES = '[[outlet]]\nname = "board"\nkind = "text_lines"\nhost = "127.0.0.1"\nport = 2002\n'


def check(folder: Path, text: str) -> Result:
    file = folder / "outlets.toml"
    file.write_text(text, encoding="utf-8")
    return CliRunner().invoke(main, ["publish", str(file), "--check"])


@contextmanager
def receiver(answer: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Answers each batch, until it is closed; its port, and the lines that came."""
    lines = list[bytes]()

    def serve(listening: socket.socket) -> None:
        try:
            with listening.accept()[0] as connection, connection.makefile("rb") as incoming:
                for line in incoming:
                    if line == b"\n":
                        connection.sendall(answer)
                    else:
                        lines.append(line)
        except OSError:  # closed before anybody came
            return

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        try:
            yield listening.getsockname()[1], lines
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_check_accepts_an_outlet_of_another_package_and_reports_a_mistake_in_it_with_its_place(example: Path) -> None:
    good = check(example, LINES)
    assert (good.exit_code, good.output.strip().endswith("good. Outlets: board (text_lines)")) == (0, True), good.output
    for old, new, says in (
        ("port = 2002", "port = 0", "outlet 'board', port: 0: expected at least 1"),
        ("port = 2002", "prot = 2002", "outlet 'board', prot: unknown key; did you mean 'port'?"),
        ('"text_lines"', '"text_line"', "outlet 'board', kind: unknown kind 'text_line'; did you mean 'text_lines'?"),
    ):
        done = check(example, LINES.replace(old, new))
        assert (done.exit_code, says in done.output) == (2, True), done.output


@pytest.mark.parametrize(
    ("answer", "account"),
    [
        (b"ok\n", "1 messages sent, 0 dropped because too many waited, 0 not accepted, 0 waiting"),
        (b"no\n", "0 messages sent, 0 dropped because too many waited, 1 not accepted, 0 waiting"),
    ],
)
def test_it_is_fed_like_the_gateway_s_own(answer: bytes, account: str, example: Path) -> None:
    message = heard("status")
    with receiver(answer) as (port, lines):
        file = example / "outlets.toml"
        file.write_text(LINES.replace("2002", str(port)), encoding="utf-8")
        (feed,) = load_outlets(file).feeds()
        feed.put(message, 0.0)
        feed.turn(0.0)
        assert feed.account == account
        feed.stop()
        feed.run(lambda: 0.0)
    assert lines == [b"mill status " + message.payload + b"\n"]


def test_what_is_away_is_tried_again(example: Path) -> None:
    with receiver(b"ok\n") as (port, _):
        pass
    file = example / "outlets.toml"
    file.write_text(LINES.replace("2002", str(port)), encoding="utf-8")
    (feed,) = load_outlets(file).feeds()
    feed.turn(0.0)
    assert f"127.0.0.1:{port}" in feed.problem


BASE = "from typing import Literal\nfrom gateway.listeners.outlets.outlet import OutletSettings\n"


WHOLE = BASE + 'class It(OutletSettings):\n    kind: Literal["strange"]\n    def outlet(self):\n        return None\n'


@pytest.mark.parametrize(
    ("code", "at_fault"),
    [
        ("import not_installed_anywhere\n", "not_installed_anywhere"),
        ("def It(): ...\n", "other_package:It"),
        (WHOLE.replace("def outlet", "def other"), "other_package:It"),
        (WHOLE.replace('"strange"', '"odd"'), "'odd'"),
        (BASE + "class It(OutletSettings):\n    def outlet(self): ...\n", "It"),
        (WHOLE.replace("return None", "raise KeyError('X')"), "KeyError: 'X'"),
    ],
)
def test_a_broken_package_is_one_line(
    code: str, at_fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {"talc_gateway.outlets": {"strange": "other_package:It"}}
    install(files_of("other", rows, {"other_package.py": code}, "2.3"), tmp_path / "site")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    done = check(tmp_path, '[[outlet]]\nname = "odd"\nkind = "strange"\n')
    assert (done.exit_code, len(done.output.strip().splitlines())) == (2, 1), done.output
    assert at_fault in done.output


def test_without_such_kinds_no_package_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(**_: object) -> None:
        raise AssertionError("looked for")

    monkeypatch.setattr("gateway.config.extensions.entry_points", never)
    done = check(tmp_path, '[[outlet]]\nname = "plant"\nkind = "mqtt"\nurl = "mqtts://broker"\n')
    assert done.exit_code == 0, done.output
