"""`python -m benchmarks thingsboard`: the 500 channels of `acquisition`, read by thingsboard-gateway and by ours.

Both get the same emulated devices at 1 Hz, one after the other, and make the same requests: the values and the fault
bits of each unit, one request each. ThingsBoard's gateway runs from its own environment (out/thingsboard), with one
Modbus connector for the serial lines and one for TCP, as ThingsBoard advises (one for each bus would cost more: each is
a thread that looks for work every millisecond), report strategy ON_RECEIVED, and without rate limits, statistics and
remote configuration. Mosquitto takes the place of the ThingsBoard server. It publishes values only; ours also checks,
stores and publishes each reading with its quality.

A channel's missed periods are the seconds less its readings. Times are those that each program gives its readings.
"""

import json
import math
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.acquisition import Windows, buses_config, emulated, readings_of, run_in_windows
from benchmarks.emulators import CHANNELS, HOSTS, LINES, UNITS
from benchmarks.rows import BenchRow
from gateway.config.file import load

_VENV = Path(__file__).parents[1] / "out" / "thingsboard"
_PINNED = ("thingsboard-gateway==3.8.5", "pymodbus==3.9.2", "pyserial==3.5", "pyserial-asyncio==0.6")
"""It would install its own version of pymodbus when it starts."""
_BROKER_PORT = 21883
_ASKED, _ANSWERED = "v1/devices/me/rpc/request/", "v1/devices/me/rpc/response/"
_NO_LIMITS = json.dumps({"rateLimits": {}, "gatewayRateLimits": {}, "maxPayloadSize": 65536, "maxInflightMessages": 0})
_WINDOW_S = 17.0
_SETTLE_S = 15.0
_ALL = (LINES + HOSTS) * UNITS * CHANNELS


def _program() -> Path:
    """The interpreter of its environment, which is made if it is absent."""
    python = _VENV / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(_VENV)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *_PINNED], check=True)
    return python


def _slave(name: str, place: Mapping[str, object], unit: int, values: int, faults: tuple[int, int]) -> dict[str, Any]:
    """One unit: `values` is the function that reads its numbers, `faults` function and address of its fault bits."""
    code, first = faults
    return {
        **place, "unitId": unit, "deviceName": name, "deviceType": "default", "pollPeriod": 1000, "timeout": 1,
        "byteOrder": "BIG", "wordOrder": "BIG", "retries": 0, "connectAttemptCount": 5, "attributes": [],
        "attributeUpdates": [], "rpc": [],
        "timeseries": [
            {"tag": "t${address}", "type": "16int", "functionCode": values, "objectsCount": 1,
             "address": f"0-{CHANNELS - 1}"},
            {"tag": "faults", "type": "bits", "functionCode": code, "objectsCount": CHANNELS, "address": first},
        ],
    }  # fmt: skip


def _configured(folder: Path, addresses: Mapping[str, Any]) -> None:
    """Its configuration for the emulated buses."""
    slaves = list[dict[str, Any]]()
    for n, port in enumerate(addresses["lines"]):
        place = {"type": "serial", "method": "rtu", "port": port, "baudrate": 115200}
        slaves += [_slave(f"line{n}_{unit}", place, unit, 4, (2, 128)) for unit in range(1, UNITS + 1)]
    for n, host_port in enumerate(addresses["hosts"]):
        host: dict[str, object] = {"type": "tcp", "method": "socket", "host": "127.0.0.1", "port": host_port}
        slaves += [_slave(f"host{n}_{unit}", host, unit, 3, (1, 120)) for unit in range(1, UNITS + 1)]
    limits = ("rateLimits", "dpRateLimits", "messagesRateLimits", "deviceMessagesRateLimits", "deviceRateLimits",
              "deviceDpRateLimits")  # fmt: skip
    server = {
        "host": "127.0.0.1", "port": _BROKER_PORT, "remoteShell": False, "remoteConfiguration": False,
        "statistics": {"enable": False}, "minPackSendDelayMS": 50, "minPackSizeToSend": 500, "qos": 1,
        "security": {"type": "accessToken", "accessToken": "bench"}, "reportStrategy": {"type": "ON_RECEIVED"},
        "checkConnectorsConfigurationInSeconds": 3600, "checkingDeviceActivity": {"checkDeviceInactivity": False},
        **dict.fromkeys(limits, "0:0,"),
    }  # fmt: skip
    storage = {"type": "memory", "read_records_count": 100, "max_records_count": 100000}
    kinds = ("serial", "tcp")
    connectors = [{"type": "modbus", "name": kind, "configuration": f"{kind}.json"} for kind in kinds]
    masters = {kind: {"slaves": [slave for slave in slaves if slave["type"] == kind]} for kind in kinds}
    files = {
        "tb_gateway.json": {"thingsboard": server, "storage": storage, "grpc": {"enabled": False},
                            "connectors": connectors},
        **{f"{kind}.json": {"name": kind, "logLevel": "ERROR", "master": master} for kind, master in masters.items()},
        "logs.json": {"version": 1, "disable_existing_loggers": False, "root": {"level": "ERROR", "handlers": []}},
    }  # fmt: skip
    (folder / "logs").mkdir()
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")


@contextmanager
def _broker(folder: Path) -> Iterator[dict[str, list[float]]]:
    """Mosquitto, and when each channel's values were measured as they come in, s since 1970."""
    config, times = folder / "mosquitto.conf", defaultdict[str, list[float]](list)
    config.write_text(f"listener {_BROKER_PORT} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
    log = (folder / "mosquitto.log").open("w")
    process = subprocess.Popen(["/usr/sbin/mosquitto", "-c", str(config)], stderr=log, stdout=log)

    def hear(_client: Client, _data: object, message: MQTTMessage) -> None:
        if message.topic.startswith(_ASKED):  # for the limits of its session; without them it sends nothing
            client.publish(_ANSWERED + message.topic.removeprefix(_ASKED), _NO_LIMITS, 1)
            return
        for device, rows in json.loads(message.payload).items():
            for row in rows:
                for tag in row["values"]:
                    if tag.startswith("t"):
                        times[f"{device} {tag}"].append(row["ts"] / 1e3)

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = hear
    try:
        _connect(client)
        client.subscribe([("v1/gateway/telemetry", 1), (_ASKED + "+", 1)])
        client.loop_start()
        yield times
        client.loop_stop()
        client.disconnect()
    finally:
        process.terminate()
        process.wait(30.0)
        log.close()


def _connect(client: Client) -> None:
    until = time.monotonic() + 30.0
    while True:
        try:
            client.connect("127.0.0.1", _BROKER_PORT)
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.2)
        else:
            return


def _judged(times: Mapping[str, Sequence[float]], windows: Windows) -> tuple[float, float]:
    """Share of missed periods, and p99 of |interval - 1 s|, s; medians of the windows, over 500 channels."""
    missed, late = [], []
    for begin, end in windows.ends:
        within = [[t for t in own if begin <= t < end] for own in times.values()]
        due = math.floor(end - begin)
        missed.append(1.0 - sum(min(len(own), due) for own in within) / (due * _ALL))
        late.append(float(np.percentile(np.concatenate([np.abs(np.diff(own) - 1.0) for own in within]), 99)))
    return median(missed), median(late)


def rows() -> list[BenchRow]:
    """Ours, then ThingsBoard's gateway, on the same emulated devices."""
    python = _program()
    with emulated() as addresses, TemporaryDirectory() as name:
        folder = Path(name)
        path = buses_config(folder, addresses)
        ours = run_in_windows([sys.executable, "-m", "gateway", "run", str(path)], folder, _SETTLE_S, _WINDOW_S)
        our_missed, our_late = _judged(readings_of(load(path), ours.ends[0][0], ours.ends[-1][1]), ours)
        theirs_in = folder / "thingsboard"
        theirs_in.mkdir()
        _configured(theirs_in, addresses)
        with _broker(folder) as times:
            command = [str(python), "-c", "from thingsboard_gateway.tb_gateway import main; main()"]
            settings = {**os.environ, "TB_GW_CONFIG_DIR": str(theirs_in)}
            theirs = run_in_windows(command, theirs_in, _SETTLE_S, _WINDOW_S, settings)
        missed, late = _judged(times, theirs)
    share, their_share = median(ours.shares), median(theirs.shares)
    what = "500 channels on 20 Modbus buses at 1 Hz"
    return [
        BenchRow(f"processor: {what}", f"{share:.1%} of a core", f"{their_share:.1%} thingsboard-gateway 3.8.5; "
                 f"ours takes {share / their_share:.2f} ×"),
        BenchRow("memory, resident", f"{ours.resident_mb:.0f} MB", f"{theirs.resident_mb:.0f} MB"),
        BenchRow("missed periods", f"{our_missed:.1%}", f"{missed:.1%}"),
        BenchRow("p99 of abs(interval - 1 s)", f"{1e3 * our_late:.0f} ms", f"{1e3 * late:.0f} ms"),
        BenchRow("our event loop waited for a core that other programs had", f"{median(ours.waits):.1%}"),
    ]  # fmt: skip
