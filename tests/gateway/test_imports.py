"""Each program loads only what it needs: memory and seconds on a small computer."""

import signal
import subprocess
import sys
import urllib.request
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.benches.free_port import free_port

BUSES = {"pymodbus", "can", "canopen", "cantools", "serial"}
NUMERICS = {"scipy", "osqp", "talc._kernel", "matplotlib", "pandas"}
PLANT = {"asyncua", "paho", "cryptography"}
"""Of OPC UA and MQTT: a name of their rooms loads one of them, and another name of the same room none."""
NEVER_BESIDE = BUSES | NUMERICS
"""Modules that no program beside a gateway needs: such a program talks to no device, and learns nothing."""
WHOLE = (
    "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr));"
    "from gateway.cli.main import main; main()"
)
"""A whole command, which prints at its end what it has loaded."""


def loaded(code: str) -> set[str]:
    """What a fresh process has loaded after this code."""
    code += "; import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return set(done.stdout.splitlines()[-1].split())


def loaded_by(command: Sequence[str], asked: str = "") -> set[str]:
    """What a command that runs until it is stopped has loaded after its first line and the answer of its page.

    asked: path on its page
    """
    process = subprocess.Popen(
        [sys.executable, "-c", WHOLE, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        first = process.stdout.readline()
        if asked:
            with urllib.request.urlopen(first.strip().rstrip("/") + asked) as answer:
                assert answer.status == 200
        process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    finally:
        process.kill()
        process.wait()
    assert first, said
    return set(said.splitlines()[-1].split())


@pytest.mark.slow
def test_a_gateway_without_opc_ua_loads_none_of_the_heavy_libraries() -> None:
    heavy = {"scipy", "osqp", "matplotlib", "jinja2", "cantools", "numpy.random"} | PLANT
    assert loaded("import gateway.cli.main, gateway.service.run").isdisjoint(heavy)


@pytest.mark.slow
def test_the_page_of_a_configuration_loads_no_bus_and_no_learner() -> None:
    config = Path(__file__).parent / "config" / "cases" / "valid" / "gateway.toml"
    modules = loaded_by(["web", str(config), "--listen", "127.0.0.1:0"], "/")
    assert "gateway.config.model" in modules
    assert not modules & (NEVER_BESIDE | PLANT)


def test_the_outlets_load_neither_a_bus_nor_numpy(tmp_path: Path) -> None:
    file = tmp_path / "outlets.toml"
    file.write_text(
        f'[source]\nconnect = ["tcp/127.0.0.1:{free_port()}"]\n[[outlet]]\nname = "plant"\nkind = "mqtt"\n'
        f'url = "mqtt://127.0.0.1:{free_port()}"\n',
        encoding="utf-8",
    )
    modules = loaded_by(["publish", str(file)])
    assert {"zenoh", "paho"} <= modules
    assert not modules & (NEVER_BESIDE | {"asyncua", "cryptography", "numpy", "gateway.config.model"})


@pytest.mark.slow
def test_the_opc_ua_server_and_the_collector_load_no_bus(tmp_path: Path) -> None:
    shown = tmp_path / "opcua.toml"
    shown.write_text('[machine.m000]\nmanufacturer = "Muster AG"\n', encoding="utf-8")
    where = ["--connect", f"tcp/127.0.0.1:{free_port()}"]
    served = loaded_by(["opcua", *where, "--settings", str(shown), "--listen", "127.0.0.1:0"])
    assert "asyncua" in served
    assert not served & (NEVER_BESIDE | {"numpy", "paho"})
    assert not [name for name in served if "standard_address_space" in name]  # 52 MB of nodes
    kept = loaded_by(["collect", str(tmp_path / "site"), *where])
    assert "pyarrow" in kept
    assert not kept & (NEVER_BESIDE | PLANT)


@pytest.mark.slow
def test_reading_and_checking_a_configuration_loads_no_bus() -> None:
    config = Path(__file__).parent / "config" / "cases" / "valid" / "gateway.toml"
    modules = loaded(f"from pathlib import Path; from gateway.config.file import load; load(Path({str(config)!r}))")
    assert {"drivers.build", "gateway.config.rules"} <= modules
    assert not modules & (NEVER_BESIDE | PLANT | {"asyncio"})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "needed", "foreign"),
    [
        ("modbus_tcp", "pymodbus", {"can", "canopen", "cantools"} | PLANT),
        ("can", "can", {"pymodbus", "canopen"} | PLANT),
        ("mqtt", "paho", {"asyncua", "cryptography"} | BUSES),
        ("opcua", "asyncua", {"paho"} | BUSES),
    ],
)
def test_a_bus_loads_the_libraries_of_its_own_kind(kind: str, needed: str, foreign: set[str]) -> None:
    where = {
        "modbus_tcp": {"host": "127.0.0.1"},
        "can": {"interface": "virtual", "channel": "one"},
        "canopen": {"interface": "virtual", "channel": "one"},
        "mqtt": {"url": "mqtt://127.0.0.1"},
        "opcua": {"url": "opc.tcp://127.0.0.1", "security": "none"},
    }.get(kind, {"port": "/dev/ttyUSB0"})
    settings = f"read_settings(BUS_KINDS[{kind!r}], {where!r})"
    modules = loaded(
        "from drivers.build import BUS_KINDS, bus_from_settings; from drivers.problems import read_settings; "
        f"bus_from_settings('one', {settings})"
    )
    assert needed in modules
    assert not modules & foreign


def test_no_command_waits_for_the_libraries_of_another() -> None:
    """The help of the whole program names every command."""
    code = "from gateway.cli.main import main; main(['--help'], standalone_mode=False)"
    assert loaded(code).isdisjoint(NEVER_BESIDE | PLANT | {"numpy", "zenoh", "rich", "gateway.config.model"})
