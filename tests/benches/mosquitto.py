"""Mosquitto, Debian's MQTT broker, for tests with marker `peer`; it can be stopped and started again on its port."""

import json
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.benches.foreign_server import ended, started
from tests.benches.free_port import free_port

LIMIT_S = 120.0


class Mosquitto:
    """A broker on loopback. It keeps nothing on disk: what was retained is gone after a stop.

    Parameters
    ----------
    folder: for its files
    settings: further lines of its configuration, such as those of TLS; None: everybody may do everything
    """

    def __init__(self, folder: Path, settings: Sequence[str] | None = None) -> None:
        program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
        assert program is not None, "mosquitto is missing: install Debian's mosquitto"
        self.port = free_port()
        self._config, self._log = folder / "mosquitto.conf", folder / "mosquitto.log"
        lines = [f"listener {self.port} 127.0.0.1", "user root", "persistence false", "log_dest stderr"]
        self._config.write_text("\n".join([*lines, *(settings or ["allow_anonymous true"])]) + "\n")
        self._program = program
        self._process: subprocess.Popen[str] | None = None

    @property
    def url(self) -> str:
        """Without TLS."""
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Returns when its port accepts a connection."""
        self._process = started([self._program, "-c", str(self._config)], self.port, self._log)

    def stop(self) -> None:
        """Ends all connections."""
        if self._process is not None:
            ended(self._process)
            self._process = None


@contextmanager
def mosquitto(folder: Path, settings: Sequence[str] | None = None) -> Iterator[Mosquitto]:
    """A broker that runs."""
    broker = Mosquitto(folder, settings)
    broker.start()
    try:
        yield broker
    finally:
        broker.stop()


def made_password(folder: Path, user: str, password: str) -> Path:
    """A password file of the broker."""
    file = folder / "passwords"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(file), user, password], check=True, capture_output=True)
    return file


class Subscriber:
    """Debian's mosquitto_sub, another maker's client library: what it hears, message by message.

    Parameters
    ----------
    broker: where
    topic: with wildcards
    more: further arguments
    """

    def __init__(self, broker: Mosquitto, topic: str, *more: str) -> None:
        command = [
            "mosquitto_sub",
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
