"""The file of `talc-gateway publish`: what it refuses, and how it says so."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main

MQTT = '[[outlet]]\nname = "plant"\nkind = "mqtt"\n'


def said(tmp_path: Path, text: str) -> tuple[int, str]:
    file = tmp_path / "outlets.toml"
    file.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(main, ["publish", str(file), "--check"])
    return done.exit_code, done.output.replace(str(tmp_path), "").strip()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (MQTT, "outlet 'plant', url: missing"),
        (f'{MQTT}url = "mqtt://10.0.0.5"', "can be read and changed by everyone in that network: expected mqtts://"),
        (f'{MQTT}url = "http://broker"', "'http://broker': expected mqtts://HOST:PORT"),
        (f'{MQTT}url = "mqtts://broker:99999"', "expected a port of 1 to 65535"),
        (f'{MQTT}url = "mqtts://broker"\nuser = "talc"', "user and password_file go together"),
        (f'{MQTT}url = "mqtts://broker"\npassword = "secret"', "password"),
        (
            f'{MQTT}url = "mqtt://127.0.0.1"\nauthority = "a.pem"',
            "authority: has no effect without TLS: write mqtts:// in url",
        ),
        (f'{MQTT}url = "mqtts://broker"\ntopic = "a/+/b"', "levels separated by /, without + and #"),
        (f'{MQTT}url = "mqtts://broker"\nkinds = ["readings"]', "'readings': expected one of reading, frame"),
        (f'{MQTT}url = "mqtts://b"\n{MQTT}url = "mqtts://c"', "another outlet has this name already"),
        (f'[source]\nconnect = ["tls/r:7447"]\n{MQTT}url = "mqtts://b"', "'tls/r:7447' needs [source.tls] authority"),
        (
            f'[source]\nprefix = "a b"\n{MQTT}url = "mqtts://b"',
            "[source] prefix: 'a b': expected letters, digits, _ and -",
        ),
        (f'{MQTT}url = "mqtts://b"\nuser = "u"\npassword_file = "absent"', "password_file: '/absent' cannot be used"),
        (f'{MQTT}url = "mqtts://b"\nauthority = "absent"', "authority: '/absent' cannot be used"),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path: Path, text: str, problem: str) -> None:
    code, output = said(tmp_path, text)
    assert (code, problem in output) == (2, True), output


def test_a_good_file_is_reported_without_using_the_network(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("secret\n")
    text = f'{MQTT}url = "mqtts://broker.plant.example"\nuser = "talc"\npassword_file = "password"\n'
    assert said(tmp_path, text) == (0, "/outlets.toml: good. Outlets: plant (mqtt)")
    allowed = f'{MQTT}url = "mqtt://10.0.0.5"\nallow_unencrypted = true\n'
    assert said(tmp_path, allowed)[0] == 0
