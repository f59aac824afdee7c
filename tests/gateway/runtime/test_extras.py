"""What a command says that needs a library which is not installed."""

import shlex
import sys
from pathlib import Path

import pytest

from gateway.runtime import extras
from gateway.runtime.extras import lack_of


@pytest.fixture(autouse=True)
def _nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda _: None)


def test_the_command_installs_into_this_environment_what_the_extra_requires() -> None:
    lack = lack_of("postgres")
    assert lack is not None
    words = shlex.split(str(lack.value_of("command")))
    assert words[words.index("--python") + 1] == sys.executable
    assert [word.partition(">")[0] for word in words[words.index("install") + 1 :]] == ["psycopg[binary]<4,", "pyarrow"]


def test_the_report_of_debians_package_is_another_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(Path("/opt/talc-gateway")))
    report, parquet = lack_of("report"), lack_of("parquet")
    assert report is not None
    assert report.says("report_not_installed")
    assert parquet is not None
    assert parquet.says("extra_not_installed")
