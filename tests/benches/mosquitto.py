"""Mosquitto, Debian's MQTT broker, for tests with marker `peer`; it can be stopped and started again on its port."""

import json
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.benches.foreign_server import RestartableServer
from tests.benches.free_port import free_port

LIMIT_S = 120.0


class Mosquitto(RestartableServer):
    """A broker on loopback. It stores nothing on disk, so retained messages are lost when it stops.

    Parameters
    ----------
    folder: for its files
    settings: further lines of its configuration, such as those of TLS; None: everybody may do everything
    """

    def __init__(self, folder: Path, settings: Sequence[str] | None = None) -> None:
        program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
        assert program is not None, "mosquitto is missing: install Debian's mosquitto"
        port, config = free_port(), folder / "mosquitto.conf"
        lines = [f"listener {port} 127.0.0.1", "user root", "persistence false", "log_dest stderr"]
        config.write_text("\n".join([*lines, *(settings or ["allow_anonymous true"])]) + "\n")
        super().__init__([program, "-c", str(config)], port, folder / "mosquitto.log")

    @property
    def url(self) -> str:
        """Without TLS."""
        return f"mqtt://127.0.0.1:{self.port}"


@contextmanager
def mosquitto(folder: Path, settings: Sequence[str] | None = None) -> Iterator[Mosquitto]:
    """A broker that runs."""
    broker = Mosquitto(folder, settings)
    with broker.running():
        yield broker


def made_password(folder: Path, user: str, password: str) -> Path:
    """A password file of the broker."""
    file = folder / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(file), user, password], check=True, capture_output=True)
    return file


class Subscriber:
    """Debian's mosquitto_sub, another maker's client: gives what it hears, message by message.

    Parameters
    ----------
    broker: where
    topic: with wildcards
    more: further arguments
    """

    def __init__(self, broker: Mosquitto, topic: str, *more: str) -> None:
        command = [
            "mosquitto_sub",
            "-W",
            "600",  # then it ends, so that a test that hears too little fails
            "-h",
            "127.0.0.1",
            "-p",
            str(broker.port),
            "-t",
            topic,
            "-F",
            "%j",
            "-q",
            "1",
            *more,
        ]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def next(self) -> tuple[str, str, bool]:
        """Topic, payload, and whether the broker had kept it."""
        assert self._process.stdout is not None
        found = json.loads(self._process.stdout.readline())
        return found["topic"], found["payload"], bool(found["retain"])

    def until(self, topic: str, payload: str) -> dict[str, tuple[str, bool]]:
        """Everything up to this message, by topic."""
        heard: dict[str, tuple[str, bool]] = {}
        while heard.get(topic, ("", False))[0] != payload:
            at, text, retained = self.next()
            heard[at] = text, retained
        return heard

    def __enter__(self) -> "Subscriber":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()
