"""`talc-gateway opcua` as a separate program, and what it refuses before it listens."""

import time
from pathlib import Path

import pytest
from asyncua.client.client import Client
from asyncua.ua import DataValue
from click.testing import CliRunner

from drivers.base import SetupError
from gateway.cli.main import main
from gateway.config.problems import ConfigError
from gateway.listeners.umati.settings import OpcUaServing, check_serving, load_serving
from gateway.runtime.passwords import make_hash
from tests.benches.free_port import free_port
from tests.benches.page_rig import ChildProgram
from tests.benches.refusals import refusing

LIMIT_S = 120.0
OWN = "urn:talc-gateway"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "panel.local"])
def test_an_address_beyond_this_computer_needs_a_certificate_and_users(host: str) -> None:
    with refusing(SetupError, "umati_open"):
        check_serving(host, OpcUaServing())


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_this_computer_may_read_without(host: str) -> None:
    check_serving(host, OpcUaServing())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'[users]\nanna = "{make_hash("a")}"', r"\[security\] and \[users\] go together"),
        ('[security]\ncertificate = "a.der"\nprivate_key = "a.pem"', r"\[security\] and \[users\] go together"),
        ('[users]\nanna = "secret"', "expected what `talc-gateway opcua --make-password` prints"),
        ('[machine.mill]\nserial = "4711"', "serial"),
        ('[machine.mill]\nmanufacturer = ""', "manufacturer"),
    ],
)
def test_settings_that_are_wrong_are_refused_with_the_field(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "opcua.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_serving(file)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "give CONFIG, or --connect ENDPOINT"),
        (["--connect", "tcp/127.0.0.1:1"], "there is no machine to show"),
        (["--connect", "127.0.0.1"], "expected PROTOCOL/HOST:PORT"),
        (["--connect", "tcp/127.0.0.1:1", "--listen", "0.0.0.0:4840"], "others could reach this address"),
        (["--connect", "tcp/127.0.0.1:1", "--listen", "4840"], "expected HOST:PORT"),
    ],
)
def test_the_command_refuses_before_it_listens(arguments: list[str], said: str) -> None:
    answer = CliRunner().invoke(main, ["opcua", *arguments], catch_exceptions=False)
    assert answer.exit_code == 2
    assert said in answer.output


@pytest.mark.slow
async def test_it_shows_what_a_gateway_publishes_until_that_is_killed(tmp_path: Path) -> None:
    port = free_port()
    settings = tmp_path / "opcua.toml"
    settings.write_text('[machine.mill]\nmanufacturer = "Muster AG"\n', encoding="utf-8")
    gateway = ChildProgram("tests.benches.played_telemetry", str(port), "mill", "all")
    assert gateway.hear() == "listening"
    there = ("--connect", f"tcp/127.0.0.1:{port}", "--settings", str(settings), "--listen", "127.0.0.1:0")
    server = ChildProgram("gateway", "opcua", *there)
    try:
        url = server.hear()
        gateway.say("go")
        assert gateway.hear() == "published"
        async with Client(url, timeout=LIMIT_S) as client:
            space = await client.get_namespace_index(OWN)
            described = await client.get_node("i=11715").get_children()
            names = {(await node.read_browse_name()).Name for node in described}
            uris = await client.get_namespace_array()
            assert names == {*uris} - {uris[1]}, "of each but the server's own"
            assert await client.get_node("i=2269").read_value(), "what it conforms to"
            (endpoint,) = await client.get_endpoints()
            assert endpoint.Server.ApplicationUri == uris[1]
            assert uris[1].endswith(":talc-gateway:mill"), "no other machine's server has the same"
            error = client.get_node(f"ns={space};s=mill/Monitoring/ThermalErrors/EX0C")

            async def until(status: str) -> DataValue:
                end = time.monotonic() + LIMIT_S
                while True:
                    found = await error.read_data_value(raise_on_bad_status=False)
                    assert found.StatusCode is not None
                    if found.StatusCode.name == status:
                        return found
                    assert time.monotonic() < end, found

            assert (await until("Good")).SourceTimestamp is not None
            gateway.kill()
            gone = await until("BadNoCommunication")
            assert gone.Value is not None
            assert gone.Value.Value is None
    finally:
        gateway.kill()
        server.kill()
