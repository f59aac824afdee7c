"""Whatever stands in a file or a message that a gateway or a program beside it gets: read, or refused with a text."""

import logging
import random
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet

from drivers.base import SetupError
from drivers.profiles import load_profile
from gateway.config.file import load
from gateway.config.problems import ConfigError
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.reporting.recordings.problems import RecordingError
from tests.benches.fuzzed_files import FILES
from tests.benches.fuzzed_messages import MESSAGES
from tests.benches.refusals import refusing

MANY = {"recordings": 150, "toml": 100, "snapshot": 100, "http": 60}
"""Examples of a kind, if not 300."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_any_file_is_read_or_refused_with_a_text(kind: str, tmp_path: Path) -> None:
    for seed in range(MANY.get(kind, 300)):
        FILES[kind](random.Random(seed), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MESSAGES)
def test_any_message_is_read_or_refused_with_a_text(
    kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.CRITICAL)
    for seed in range(MANY.get(kind, 300)):
        MESSAGES[kind](random.Random(seed), tmp_path)


@pytest.mark.parametrize("value", ["[" * 3000, "9" * 5000, "0x" + "f" * 5000])
def test_what_cannot_be_shown_is_refused_in_a_configuration_and_in_a_profile(value: str, tmp_path: Path) -> None:
    file = tmp_path / "some.toml"
    file.write_text(f"x = {value}", encoding="utf-8")
    with pytest.raises(ConfigError, match="is not valid TOML"):
        load(file)
    with refusing(SetupError, "profile_not_toml"):
        load_profile(str(file))


def test_a_parquet_file_with_a_name_that_is_no_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "machine.parquet"
    parquet.write_table(pa.table({"time": [0.0, 300.0], "plain": [1.0, 2.0]}), file, store_schema=False)
    file.write_bytes(file.read_bytes().replace(b"plain", b"\x80lain"))
    with pytest.raises(RecordingError, match="is not a readable Parquet file"):
        read_recording(file, Columns(), 300.0)
