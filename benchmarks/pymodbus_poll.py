"""`python -m benchmarks.pymodbus_poll SECONDS WINDOWS WHERE`: a bare polling loop with pymodbus' own client.

It makes the same requests to the same units at the same rate; nothing is decided, checked, stored or published. Prints
JSON: share of a core, and p99 of |interval - 1 s| in ms for each of WINDOWS windows of SECONDS seconds.
"""

import asyncio
import json
import sys
import time

import numpy as np
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from benchmarks.emulators import CHANNELS, UNITS

_WARM_UP_S = 3.0


async def _poll(client: AsyncModbusSerialClient | AsyncModbusTcpClient, end_s: float) -> list[list[float]]:
    await client.connect()
    serial = isinstance(client, AsyncModbusSerialClient)
    times: list[list[float]] = [[] for _ in range(UNITS)]
    due = time.monotonic()
    while due < end_s:
        await asyncio.sleep(due - time.monotonic())
        for unit in range(1, UNITS + 1):
            if serial:
                values = await client.read_input_registers(0, count=CHANNELS, device_id=unit)
                faults = await client.read_discrete_inputs(128, count=CHANNELS, device_id=unit)
            else:
                values = await client.read_holding_registers(0, count=CHANNELS, device_id=unit)
                faults = await client.read_coils(120, count=CHANNELS, device_id=unit)
            if values.isError() or faults.isError():
                raise RuntimeError(f"unit {unit} refused: {values}, {faults}")
            times[unit - 1].append(time.monotonic())
        due += 1.0
    client.close()
    return times


async def _run(seconds: float, windows: int, lines: list[str], hosts: list[int]) -> None:
    clients: list[AsyncModbusSerialClient | AsyncModbusTcpClient] = []
    clients += [AsyncModbusSerialClient(port, baudrate=115200) for port in lines]
    clients += [AsyncModbusTcpClient("127.0.0.1", port=port) for port in hosts]
    end_s = time.monotonic() + _WARM_UP_S + windows * seconds
    tasks = [asyncio.create_task(_poll(client, end_s)) for client in clients]
    await asyncio.sleep(_WARM_UP_S)
    cpu, begun = time.process_time(), time.monotonic()
    await asyncio.sleep(windows * seconds - 1.0)
    share = (time.process_time() - cpu) / (time.monotonic() - begun)
    late = [np.array_split(abs(np.diff(t)[3:] - 1.0), windows) for times in await asyncio.gather(*tasks) for t in times]
    p99_ms = [float(np.percentile(np.concatenate(window), 99)) * 1e3 for window in zip(*late, strict=True)]
    print(json.dumps([share, p99_ms]))


if __name__ == "__main__":
    where = json.loads(sys.argv[3])
    asyncio.run(_run(float(sys.argv[1]), int(sys.argv[2]), where["lines"], where["hosts"]))
