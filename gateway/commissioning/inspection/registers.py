"""Registers and bits of one Modbus unit: every number that they may be, side by side, and the draft of a profile."""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path

import click
from rich.table import Table

from drivers.bus_settings import Parity
from drivers.modbus.bus import ModbusBus, ModbusTcpBus
from drivers.modbus.numbers import NumberFormat, NumberType
from drivers.modbus.rtu import ModbusRtuBus, ModbusRtuTcpBus
from drivers.modbus.settings import ModbusRtuSettings, ModbusRtuTcpSettings, ModbusTcpSettings
from drivers.problems import read_settings
from gateway.acquisition.text import number_text
from gateway.commissioning.inspection.draft import Draft, now_text, write_draft
from gateway.commissioning.inspection.sweep import Guess, changed, guess, swept
from gateway.commissioning.scan.found import open_bus
from gateway.commissioning.scan.registers import ORDERS, Meaning, SeenWords, profile_draft, read_words
from gateway.commissioning.scan.tcp import scanned_host
from gateway.runtime.boundary import contained
from gateway.runtime.terminal import terminal

_ORDER_NAMES = {
    ("big", "big"): "as they are",
    ("big", "little"): "bytes swapped",
    ("little", "big"): "words swapped",
    ("little", "little"): "both swapped",
}
"""Word order and byte order, in the words of a table's head."""
_LIKELY: Mapping[NumberType, tuple[float, float]] = {"float64": (1e-6, 1e9), "int64": (1, 1e12)}
"""Smallest and largest magnitude of a 64-bit number that a device may mean."""


def inspect_registers(
    bus: ModbusBus,
    unit: int,
    function: int,
    addresses: Sequence[int],
    where: str,
    draft: Draft,
    form: NumberFormat,
) -> bool:
    """Read the addresses, print the tables and write the draft; False if nothing was read."""
    seen = asyncio.run(_read(bus, unit, function, addresses))
    console = terminal()
    for table in word_tables(seen):
        console.print(table)
    for refused in seen.refusals():
        console.print(f"- unit {unit} refuses {refused}", highlight=False, soft_wrap=True)
    if draft.file is not None and seen.words:
        _write(draft.file, seen, Meaning(form, draft.scale, draft.quantity), unit, where)
    return bool(seen.words)


def sweep_unit(bus: ModbusBus, unit: int, most: int, where: str, draft: Draft) -> bool:
    """Read all tables, again once a sensor is warm, print what changed and how it is likely meant, and write the draft;
    False if nothing was read."""
    click.echo(f"asks for the addresses below {most} in four tables; a serial line takes half a minute", err=True)
    before = asyncio.run(_swept(bus, unit, most))
    for function, seen in before.items():
        runs = ", ".join(f"{first}-{first + len(words) - 1}" for first, words in seen.runs())
        click.echo(f"function {function}: {len(seen.words)} addresses answer: {runs}")
    if not before:
        return False
    after = asyncio.run(_again(bus, unit, before)) if _warmed() else before
    console, guesses = terminal(), list[Guess]()
    for function, seen in before.items():
        moved = changed(seen, after[function])
        pairs = {a + i for a in moved for i in (-1, 0, 1) if a + i in seen.words}
        for table in word_tables(SeenWords(function, {a: after[function].words[a] for a in sorted(pairs)})):
            console.print(table)
        if seen.has_bits or not (found := guess(seen, after[function])):
            continue
        guesses.append(found)
        then, now = seen.numbers(found.form), after[function].numbers(found.form)
        most_moved = max(found.addresses, key=lambda address: abs(now[address] - then[address]))
        for address in found.addresses:
            moves = set(range(address, address + found.form.registers)) & set(moved)
            mark = "" if not moves else "  changed most" if address == most_moved else "  changed"
            click.echo(f"function {function}, address {address}: {_form_text(found)}: "
                       f"{then[address] * found.scale:g}, then {now[address] * found.scale:g}{mark}")  # fmt: skip
    if draft.file is not None and guesses:
        best = max(
            guesses, key=lambda one: (len(changed(before[one.function], after[one.function])), len(one.addresses))
        )
        _write(draft.file, best.words(after[best.function]), best.meaning(draft.quantity), unit, where)
    elif draft.file is not None:
        click.echo("nothing looks like a temperature; read its addresses with `inspect registers`", err=True)
    return True


def _warmed() -> bool:
    """Whether somebody warmed a sensor. An input that has ended is no."""
    try:
        click.prompt("Warm one sensor by hand, or wet it; Enter when it is warm", default="", show_default=False)
    except click.Abort:
        click.echo()
        return False
    return True


def _form_text(found: Guess) -> str:
    form = found.form
    order = _ORDER_NAMES[form.word_order, form.byte_order]
    return f"{form.type} {order}" + ("" if found.scale == 1 else f" x {found.scale:g}")


async def _swept(bus: ModbusBus, unit: int, most: int) -> Mapping[int, SeenWords]:
    async with open_bus(bus):
        return await contained(swept(bus, unit, most), f"the requests to unit {unit}")


async def _again(bus: ModbusBus, unit: int, before: Mapping[int, SeenWords]) -> Mapping[int, SeenWords]:
    async with open_bus(bus):
        found = {}
        for function, seen in before.items():
            asked = read_words(bus, unit, function, sorted(seen.words))
            found[function] = await contained(asked, f"the requests to unit {unit}")
        return found


def modbus_at(where: str, unit: int, *, baud: int, parity: Parity, rtu: bool, timeout_s: float) -> ModbusBus:
    """The bus at a serial port, or at host or host:port, which can have this unit. Raises SetupError, or
    click.UsageError."""
    bus = _bus_at(where, baud, parity, rtu, timeout_s)
    low, high = bus.units
    if not low <= unit <= high:
        raise click.UsageError(f"--unit {unit}: expected {low} to {high} on {bus.kind}")
    return bus


def _bus_at(where: str, baud: int, parity: Parity, rtu: bool, timeout_s: float) -> ModbusBus:
    if "/" in where or Path(where).exists():
        if rtu:
            raise click.UsageError(f"--rtu: {where} is a serial port; give host:port of a device server")
        line = {"port": where, "baud": baud, "parity": parity, "timeout_s": timeout_s}
        return ModbusRtuBus("inspect", read_settings(ModbusRtuSettings, line))
    try:
        host, port = scanned_host(where)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
    if rtu and port is None:
        raise click.UsageError(f"--rtu: give the device server's port, such as {host}:4001")
    place: dict[str, object] = {"host": host, "timeout_s": timeout_s} | ({} if port is None else {"port": port})
    if rtu:
        return ModbusRtuTcpBus("inspect", read_settings(ModbusRtuTcpSettings, place))
    return ModbusTcpBus("inspect", read_settings(ModbusTcpSettings, place))


async def _read(bus: ModbusBus, unit: int, function: int, addresses: Sequence[int]) -> SeenWords:
    async with open_bus(bus):
        return await contained(read_words(bus, unit, function, addresses), f"the requests to unit {unit}")


def word_tables(seen: SeenWords) -> list[Table]:
    """Every reading of the words side by side; columns of numbers that need a register that is not known stay empty."""
    if not seen.words:
        return []
    if seen.has_bits:
        bits = Table("address", "bit", title=f"function {seen.function}", title_justify="left")
        for address, bit in sorted(seen.words.items()):
            bits.add_row(str(address), str(bit))
        return [bits]
    widest = _widest(seen)
    return [_narrow(seen), *([_wide(seen)] if len(seen.words) > 1 else []), *([widest] if widest.row_count else [])]


def _narrow(seen: SeenWords) -> Table:
    table = Table("address", "hex", "int16", "x 0.1", "uint16", "bytes swapped", "x 0.1", title_justify="left")
    table.title = f"function {seen.function}: one register each"
    signed, unsigned, swapped = (
        seen.numbers(form) for form in (NumberFormat("int16"), NumberFormat("uint16"), NumberFormat("int16", "little"))
    )
    for a, word in sorted(seen.words.items()):
        table.add_row(
            str(a), f"{word:04X}", f"{signed[a]}", f"{signed[a] * 0.1:.1f}", f"{unsigned[a]}", f"{swapped[a]}",
            f"{swapped[a] * 0.1:.1f}",
        )  # fmt: skip
    return table


def _wide(seen: SeenWords) -> Table:
    table = Table("address", "type", *(_ORDER_NAMES[order] for order in ORDERS), title_justify="left")
    table.title = f"function {seen.function}: two registers each, from this address on"
    integers = [seen.numbers(NumberFormat("int32", byte, word)) for word, byte in ORDERS]
    reals = [seen.numbers(NumberFormat("float32", byte, word)) for word, byte in ORDERS]
    for a in integers[0]:
        table.add_row(f"{a}", "int32", *(f"{of[a]}" for of in integers))
        table.add_row("", "x 0.1", *(f"{of[a] * 0.1:.1f}" for of in integers))
        table.add_row("", "float32", *(number_text(of[a]) for of in reals), end_section=True)
    return table


def _widest(seen: SeenWords) -> Table:
    """Where four registers hold a number that a device may mean; any other four would mostly give meaningless
    numbers."""
    table = Table("address", "type", *(_ORDER_NAMES[order] for order in ORDERS), title_justify="left")
    table.title = f"function {seen.function}: four registers each, where one order gives a likely number"
    for kind, (least, most) in _LIKELY.items():
        of_orders = [seen.numbers(NumberFormat(kind, byte, word)) for word, byte in ORDERS]
        for a in of_orders[0]:
            if any(least <= abs(of[a]) <= most for of in of_orders):
                numbers = [of[a] for of in of_orders]
                table.add_row(f"{a}", kind, *(f"{n}" if isinstance(n, int) else number_text(n) for n in numbers))
    return table


def _write(path: Path, seen: SeenWords, meaning: Meaning, unit: int, where: str) -> None:
    """Raises click.UsageError for numbers that the registers cannot hold, SetupError for an unknown unit."""
    try:
        text = profile_draft(seen, meaning, place=f"unit {unit} at {where}", when=now_text())
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    write_draft(path, text, unit)
