"""A user's own profile is read once when the configuration is loaded: what was checked is what runs."""

import os
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from gateway.acquisition.build import lines_of
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from tests.benches.service_file import MACHINE, m7015, rtu_bus
from tests.benches.stepped_clock import SteppedClock

PROFILE = (files("drivers") / "profiles" / "icpdas_m7015.toml").read_text(encoding="utf-8")


def loaded(folder: Path) -> GatewayConfig:
    (folder / "mine.toml").write_text(PROFILE, encoding="utf-8")
    file = folder / "gateway.toml"
    devices = m7015("rtd1", 1, "bed = 0", "mine.toml") + m7015("rtd2", 2, "column = 0", "mine.toml")
    file.write_text(MACHINE + rtu_bus() + devices, encoding="utf-8")
    return load(file)


def test_it_is_opened_once_however_many_devices_have_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    opens = os.open

    def counted(path: Path, *arguments: Any, **named: Any) -> int:
        opened.append(Path(path).name)
        return opens(path, *arguments, **named)

    monkeypatch.setattr(os, "open", counted)
    lines_of(loaded(tmp_path), SteppedClock())
    assert opened.count("mine.toml") == 1


def test_the_drivers_are_made_from_what_was_checked(tmp_path: Path) -> None:
    config = loaded(tmp_path)
    (tmp_path / "mine.toml").write_text("protocol = 'none'", encoding="utf-8")
    (line,) = lines_of(config, SteppedClock())
    assert [driver.channels for driver in line.drivers] == [("bed",), ("column",)]
    with pytest.raises(ConfigError, match="'none' is invalid"):
        load(tmp_path / "gateway.toml")
