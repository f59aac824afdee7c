"""Cost of the outlets: `python -m tests.benches.outlets_cost SECONDS KEYS`.

One gateway with KEYS readings a second, and a decision with an event every ten, a router, Mosquitto, InfluxDB and the
outlets run, each as a process; one of two OPC UA servers has a client that subscribes to every value of the machine,
each second. Prints processor time and memory of each program that passes messages on.
"""

import asyncio
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from asyncua import ua
from asyncua.client.client import Client
from asyncua.common.node import Node

from tests.benches.free_port import free_port
from tests.benches.line_servers import influxdb1
from tests.benches.mosquitto import mosquitto

_SETTLED_S = 15.0
_TICKS = os.sysconf("SC_CLK_TCK")


def used(process: int) -> tuple[float, float, float]:
    """Processor time, s, resident memory, and what of it no other process shares, MB."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    kilobytes = {
        line.split(":")[0]: int(line.split()[1])
        for line in Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    }
    own = kilobytes["Private_Clean"] + kilobytes["Private_Dirty"]
    return (int(fields[11]) + int(fields[12])) / _TICKS, kilobytes["Rss"] * 1.024e-3, own * 1.024e-3


@contextmanager
def program(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A program; entered when it has printed its first line, which is yielded too."""
    with subprocess.Popen(
        [sys.executable, "-m", *map(str, arguments)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line
            yield process, line.strip()
        finally:
            process.terminate()
            process.communicate()


class _Taken:
    """What the OPC UA client received."""

    def __init__(self) -> None:
        self.many, self.expected = 0, -1
        self.every = asyncio.Event()
        """Set when as many notifications have come as there are values."""

    def datachange_notification(self, node: Node, value: object, data: object) -> None:
        self.many += 1
        if self.many == self.expected:
            self.every.set()


async def subscribe(url: str) -> None:
    """Subscribe to every value of the first machine until the standard input ends; prints how many values there are,
    and at the end how many changes came."""
    async with Client(url, timeout=60.0) as client:
        space = await client.get_namespace_index("urn:talc-gateway")
        values, taken = list[Node](), _Taken()
        await _variables(client.get_node(f"ns={space};s=m000"), values)
        taken.expected = len(values)
        subscription = await client.create_subscription(1000.0, taken)
        await subscription.subscribe_data_change(values)
        await asyncio.wait_for(taken.every.wait(), 60.0)
        print(len(values), flush=True)
        await asyncio.to_thread(sys.stdin.read)
        print(taken.many, flush=True)


async def _variables(node: Node, found: list[Node]) -> None:
    if await node.read_node_class() == ua.NodeClass.Variable:
        found.append(node)
    for child in await node.get_children():
        await _variables(child, found)


def main(seconds: float, keys: int) -> None:
    """Prints a line for each program."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, port = Path(name), free_port()
        (folder / "site").mkdir()
        broker = stack.enter_context(mosquitto(folder))
        database = stack.enter_context(influxdb1(folder))
        source = f'[source]\nconnect = ["tcp/127.0.0.1:{port}"]\n'
        mqtt = f'[[outlet]]\nname = "plant"\nkind = "mqtt"\nurl = "{broker.url}"\n'
        influx = f'[[outlet]]\nname = "history"\nkind = "influxdb"\nurl = "{database.url}"\ndatabase = "talc"\n'
        shown = folder / "opcua.toml"
        shown.write_text('[machine.m000]\nmanufacturer = "Muster AG"\n', encoding="utf-8")
        stack.enter_context(program("tests.benches.site_parts", "router", port))
        stack.enter_context(program("tests.benches.site_parts", "gateways", port, folder / "site", 0, 1, keys, 1))
        running = dict[str, subprocess.Popen[str]]()
        for title, outlets in (("publish: no message", ""), ("publish: MQTT and InfluxDB", mqtt + influx)):
            file = folder / f"outlets{len(running)}.toml"
            only = '[[outlet]]\nkinds = ["model"]\n' + mqtt.partition("\n")[2]
            file.write_text(source + (outlets or only), encoding="utf-8")
            running[title], _ = stack.enter_context(program("gateway", "publish", file))
        listening = ("--connect", f"tcp/127.0.0.1:{port}", "--settings", shown, "--listen", "127.0.0.1:0")
        running["opcua, without a client"], _ = stack.enter_context(program("gateway", "opcua", *listening))
        running["opcua, with a client"], url = stack.enter_context(program("gateway", "opcua", *listening))
        time.sleep(_SETTLED_S)
        client, many = stack.enter_context(program("tests.benches.outlets_cost", "client", url))
        before = {title: used(process.pid)[0] for title, process in running.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        took_s = time.monotonic() - began_s
        for title, process in running.items():
            cpu_s, memory_mb, own_mb = used(process.pid)
            share = 100.0 * (cpu_s - before[title]) / took_s
            print(f"{title:<28}{share:6.2f} % of a core {memory_mb:6.0f} MB, {own_mb:.0f} MB of it its own")
        rows = database.ask('SELECT count("value") FROM "reading"')
        print(f"readings in InfluxDB: {rows}")
        changes, _ = client.communicate()
        print(f"changes of {many} values of OPC UA: {changes.strip()}")


if __name__ == "__main__" and sys.argv[1] == "client":
    asyncio.run(subscribe(sys.argv[2]))
elif __name__ == "__main__":
    main(float(sys.argv[1]), int(sys.argv[2]))
