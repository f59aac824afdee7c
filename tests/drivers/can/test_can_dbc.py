"""Plain CAN by DBC: the logger's frames are packed by hand, the driver reads them by the DBC file."""

import asyncio
import math
import struct
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import ConnectError, Driver, NoAnswer, Quality, Reading, SetupError, SystemClock
from drivers.build import make_device
from drivers.can.dbc_file import DbcFile
from drivers.can.dbc_profile import CanDbcProfile, DbcSignal
from drivers.faults import Fault as Faulty
from drivers.profiles import load_profile
from simulators.devices import SlcanAdapter
from simulators.devices.can_logger import CanLogger
from simulators.devices.source import SensorFault
from tests.benches.buses import make_bus
from tests.benches.driver_reads import read_until_error
from tests.benches.logger_files import logger_dbc, logger_profile, logger_profile_text
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

TEMPERATURES = [20.0, -3.3, 150.5, 0.0, 33.3]
PROFILE = logger_profile_text("logger")


@asynccontextmanager
async def bench(profile: str) -> AsyncIterator[tuple[CanLogger, Driver, SlcanAdapter]]:
    adapter = SlcanAdapter([])
    logger = CanLogger(lambda: TEMPERATURES, adapter.send)
    options = {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2}
    bus = make_bus("can1", "can", options)
    channels = {f"t{i}": i for i in range(5)}
    driver = make_device("logger", bus, profile, 1, channels, {}, SystemClock())
    logger.start()
    try:
        await bus.connect()
        await driver.connect()
        yield logger, driver, adapter
    finally:
        logger.stop()
        await bus.close()
        await adapter.stop()


async def test_values_come_by_the_names_of_the_dbc_file(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (_, driver, _adapter):
        readings = await driver.read()
    assert [r.value for r in readings] == pytest.approx(TEMPERATURES, abs=1e-9)
    assert {(r.quality, r.unit) for r in readings} == {(Quality.GOOD, "degC")}


async def test_broken_sensors_and_what_is_beyond_the_range(tmp_path: Path) -> None:
    expected = {
        SensorFault.OPEN: Quality.SENSOR_FAULT,
        SensorFault.SHORT: Quality.SENSOR_FAULT,
        SensorFault.OVER: Quality.OUT_OF_RANGE,
        SensorFault.UNDER: Quality.OUT_OF_RANGE,
    }
    async with bench(logger_profile(tmp_path)) as (logger, driver, _):
        for fault, quality in expected.items():
            logger.faults.set(1, fault)
            async with asyncio.timeout(60.0):
                while (readings := await driver.read())[1].quality is not quality:
                    await asyncio.sleep(0.005)
            assert math.isnan(readings[1].value)
            assert [r.quality for i, r in enumerate(readings) if i != 1] == [Quality.GOOD] * 4
            logger.faults.set(1, None)


async def test_silent_logger_gives_no_answer_and_recovers(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (logger, driver, _):
        logger.faults.silent = True
        with pytest.raises(NoAnswer, match=r"0x300, 0x301"):
            await read_until_error(driver)
        logger.faults.silent = False
        async with asyncio.timeout(60.0):
            assert (await until_answered(driver))[0].value == pytest.approx(20.0)


async def test_missing_message_costs_its_own_channels_only(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (logger, driver, adapter):
        logger.stop()
        with pytest.raises(NoAnswer):
            await read_until_error(driver)
        adapter.send(logger.frames()[:1])
        async with asyncio.timeout(0.15):  # as long as the frame is fresh
            readings = await until_answered(driver)
    assert [r.quality for r in readings] == [Quality.GOOD] * 4 + [Quality.COMM_FAULT]


async def test_a_value_is_as_old_as_its_frame(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (logger, driver, adapter):
        logger.stop()
        with pytest.raises(NoAnswer):
            await read_until_error(driver)
        adapter.send(logger.frames())
        first = await until_answered(driver)
        await asyncio.sleep(0.1)  # of the 0.2 s for which a frame counts
        again, now = await driver.read(), (time.monotonic(), datetime.now(UTC))
    assert [r.monotonic_s for r in again] == pytest.approx([r.monotonic_s for r in first], abs=0.01)
    assert all(now[0] - r.monotonic_s >= 0.1 and (now[1] - r.source_time).total_seconds() >= 0.09 for r in again)


async def until_answered(driver: Driver) -> Sequence[Reading]:
    while True:
        try:
            return await driver.read()
        except NoAnswer:
            await asyncio.sleep(0.005)


async def test_logger_that_was_silent_for_long_is_not_waited_for(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (logger, driver, _):
        logger.faults.silent = True
        with pytest.raises(NoAnswer):
            await read_until_error(driver)
        begun = time.monotonic()
        for _ in range(5):
            with pytest.raises(NoAnswer):
                await driver.read()
        assert time.monotonic() - begun < 0.2


async def test_unplugged_adapter_is_a_connection_fault(tmp_path: Path) -> None:
    async with bench(logger_profile(tmp_path)) as (logger, driver, adapter):
        logger.stop()
        await adapter.stop()
        with pytest.raises(ConnectError, match="is gone"):
            await read_until_error(driver)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("logger.dbc", "nowhere.dbc", "dbc: path_unreadable why=No_such_file_or_directory"),
        ('"T2"', '"T9"', "signal[2].name: dbc_no_signal signal=T9 possible names=T0,_T1,_T2,_T3"),
        ('"Second"', '"Third"', "signal[4].message: dbc_no_message message=Third possible names=First,_Real,_Second"),
    ],
)
def test_mistakes_in_the_profile_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    with refusing(SetupError, says):
        load_profile(logger_profile(tmp_path, text=PROFILE.replace(old, new)))


INVALID = PROFILE[PROFILE.index("invalid = ") : PROFILE.index("[[signal]]", PROFILE.index("invalid = "))]
"""The rules of the first signal, 16 bits with a sign."""


def ruled(folder: Path, *rules: str, old: str = INVALID, before: str = "") -> DbcSignal:
    """The logger's first signal with these rules; `before` them, what else takes the place of `old` in the profile."""
    text = PROFILE.replace(old, f"{before}invalid = [{', '.join(rules)}]\n", 1)
    profile = load_profile(logger_profile(folder, text=text))
    assert isinstance(profile, CanDbcProfile)
    return profile.signals[0]


def real(folder: Path, *rules: str) -> DbcSignal:
    """The same with a real number in the place of the first signal."""
    return ruled(
        folder, *rules, old=f'message = "First"\nname = "T0"\n{INVALID}', before='message = "Real"\nname = "F"\n'
    )


def rule(text: str, quality: str = "sensor_fault") -> str:
    return f'{{ {text}, quality = "{quality}", detail = "{text}" }}'


@pytest.mark.parametrize(
    ("stated", "inside", "outside"),
    [
        ("low = 7000, high = 7100", (7000, 7050, 7100), (6999, 7101, -7050)),
        ("low = 8000", (8000, 8500, 32767), (7999, -8000)),
        ("high = -1500", (-1500, -1999, -32768), (-1499, 0, 8000)),
        ("low = -1, high = -1", (-1,), (0, -2)),
    ],
)
def test_range_of_raw_numbers_is_a_fault(
    tmp_path: Path, stated: str, inside: Sequence[int], outside: Sequence[int]
) -> None:
    signal = ruled(tmp_path, rule(stated))
    for raw in inside:
        assert signal.decode(struct.pack("<4h", raw, 0, 0, 0)) == Faulty(Quality.SENSOR_FAULT, stated)
    for raw in outside:
        value = signal.decode(struct.pack("<4h", raw, 0, 0, 0))
        assert value == pytest.approx(raw / 10) if raw >= -2000 else isinstance(value, Faulty)


def test_first_rule_that_fits_counts_whatever_its_form(tmp_path: Path) -> None:
    rules = rule("equals = 7050"), rule("low = 7000"), rule("bit = 0", "out_of_range")
    signal = ruled(tmp_path, *rules)
    details = {}
    for raw in (7050, 7051, 101, 100):
        found = signal.decode(struct.pack("<4h", raw, 0, 0, 0))
        details[raw] = found.detail if isinstance(found, Faulty) else found
    assert details == {7050: "equals = 7050", 7051: "low = 7000", 101: "bit = 0", 100: pytest.approx(10.0)}


def test_range_of_a_real_number_is_a_fault(tmp_path: Path) -> None:
    signal = real(tmp_path, rule("low = 99.5"), rule("high = -1e3"))
    for number, fault in ((99.25, None), (99.5, "low = 99.5"), (-999.0, None), (-1e3, "high = -1e3")):
        found = signal.decode(struct.pack("<f", number))
        assert found == (number if fault is None else Faulty(Quality.SENSOR_FAULT, fault))
    for number in (math.inf, -math.inf, math.nan):
        assert isinstance(signal.decode(struct.pack("<f", number)), Faulty)


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        ("low = 5, high = 4", "signal[0].invalid[0].range.low: above_high low=5 high=4"),
        ("low = 40000", "signal[0].invalid[0].low: not_within value=40000 low=-32768 high=32767"),
        ("high = -32769", "signal[0].invalid[0].high: not_within value=-32769 low=-32768 high=32767"),
        ("low = -32768", "signal[0].invalid[0].low: rule_of_all low=-32768 high=32767"),
        ("low = 1.5", "signal[0].invalid[0].low: expected value=1.5 a_whole_number"),
        ("low = 1, mask = 3", "signal[0].invalid[0].mask: unknown_key mean"),
        ("low = 1, equals = 3", "signal[0].invalid[0].equals: unknown_key mean"),
    ],
)
def test_impossible_ranges_are_named(tmp_path: Path, stated: str, says: str) -> None:
    with refusing(SetupError, says):
        ruled(tmp_path, rule(stated))


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        ("low = inf", "signal[0].invalid[0].low: either expected value=inf a_whole_number a_finite_number"),
        ("low = 2.5, high = 2.25", "signal[0].invalid[0].range.low: above_high low=2.5 high=2.25"),
        ("bit = 0", "signal[0].invalid[0].mask: rule_of_real name=F"),
    ],
)
def test_impossible_ranges_of_a_real_number_are_named(tmp_path: Path, stated: str, says: str) -> None:
    with refusing(SetupError, says):
        real(tmp_path, rule(stated))


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> CanDbcProfile:
    text = PROFILE + '[[signal]]\nmessage = "Real"\nname = "F"\n'
    profile = load_profile(logger_profile(tmp_path_factory.mktemp("dbc"), text=text))
    assert isinstance(profile, CanDbcProfile)
    return profile


@given(data=st.binary(max_size=64))
def test_any_frame_is_decoded_or_a_fault(loaded: CanDbcProfile, data: bytes) -> None:
    *shorts, real = (signal.decode(data) for signal in loaded.signals)
    for i, value in enumerate(shorts):
        place = 2 * (i % 4)
        if len(data) < place + 2:  # a frame may be shorter than its message
            assert isinstance(value, Faulty)
            continue
        (raw,) = struct.unpack_from("<h", data, place)
        if -2000 <= raw <= 8500:
            assert value == pytest.approx(raw / 10)
        else:
            assert isinstance(value, Faulty)
    if len(data) >= 4 and math.isfinite(struct.unpack_from("<f", data)[0]):
        assert real == struct.unpack_from("<f", data)[0]
    else:
        assert isinstance(real, Faulty)


def described(folder: Path, dbc: str, message: str = "First", name: str = "T0") -> DbcSignal:
    """The only signal of a profile with this DBC file."""
    (folder / "other.dbc").write_text(dbc)
    text = 'protocol = "can_dbc"\ntitle = "x"\nunit = "degC"\ndbc = "other.dbc"\n'
    (folder / "other.toml").write_text(text + f'[[signal]]\nmessage = "{message}"\nname = "{name}"\n')
    profile = load_profile(str(folder / "other.toml"))
    assert isinstance(profile, CanDbcProfile)
    return profile.signals[0]


FRAME = struct.pack("<4h", -123, 0, 0, 0)
DBC = logger_dbc()
OTHER = "BO_ 1000 Other: 2 L\n"


@pytest.mark.parametrize(
    "more",
    [
        pytest.param(OTHER + ' SG_ A : 0|12@1+ (1,0) [0|0] "" L\n SG_ B : 8|8@1+ (1,0) [0|0] "" L\n', id="overlap"),
        pytest.param(OTHER + ' SG_ A : 0|17@1+ (1,0) [0|0] "" L\n', id="does not fit"),
        pytest.param(OTHER + ' SG_ A : 0|4000000000@1+ (1,0) [0|0] "" L\n', id="gigabytes to describe"),
        pytest.param(OTHER + ' SG_ A : 0|4@1+ (one,0) [0|0] "" L\n', id="no number"),
        pytest.param(OTHER + ' SG_ A m7 : 0|4@1+ (1,0) [0|0] "" L\n', id="page without a selector"),
        pytest.param(OTHER + OTHER.replace("1000", "1001"), id="two of a name"),
        pytest.param('BA_ "Undefined" BO_ 768 5;\nBA_ "Undefined" 1;\n', id="attribute without definition"),
        pytest.param('CM_ "two lines\nBO_ 768 First: 8 L\n SG_ T0 : 0|1@1+ (1,0) [0|0] \\" L";\n', id="comment"),
        pytest.param('VAL_ 999 Nothing 0 "no";\nSIG_VALTYPE_ 999 Nothing : 1;\n', id="of no message"),
    ],
)
def test_what_no_channel_needs_in_the_dbc_file_does_not_matter(tmp_path: Path, more: str) -> None:
    assert described(tmp_path, DBC + more).decode(FRAME) == pytest.approx(-12.3)


@pytest.mark.parametrize("more", ["\n", "SG_MUL_VAL_ 1 a 1-1 "])
def test_what_a_file_repeats_is_looked_at_once(more: str) -> None:
    """100,000 blank lines took 17 s, as each began a search through all that follow."""
    file, began_s = DbcFile(logger_dbc() + 100_000 * more), time.process_time()
    assert file.only(list(file.messages.values()))
    assert time.process_time() - began_s < 5.0


@pytest.mark.parametrize("mark", ["\ufeff", "ï»¿"], ids=["read as UTF-8", "read as cp1252"])
def test_a_byte_order_mark_does_not_matter(tmp_path: Path, mark: str) -> None:
    assert described(tmp_path, mark + DBC[DBC.index("BU_") :]).decode(FRAME) == pytest.approx(-12.3)


LINE = ' SG_ T0 : 0|16@1- (0.1,0) [-200|850] "degC" G\n'


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        pytest.param("BO_ 769 Second", "BO_ 769 First", "message", id="two messages of the name"),
        pytest.param(
            LINE,
            ' SG_ Page M : 56|8@1+ (1,0) [0|0] "" G\n' + LINE.replace("T0", "T0 m0") + LINE.replace("T0", "T0 m1"),
            "name",
            id="two pages",
        ),
        pytest.param(LINE, LINE.replace("0|16", "0|65"), "name", id="longer than its frame"),
        pytest.param(LINE, LINE.replace("0|16", "0|4000000000"), "name", id="gigabytes"),
        pytest.param(LINE, LINE.replace("0|16", "50|16"), "name", id="beyond the end"),
        pytest.param(LINE, LINE.replace("0|16", "0|17"), "name", id="over another"),
    ],
)
def test_a_signal_that_the_dbc_file_does_not_state_once_and_whole_is_refused(
    tmp_path: Path, old: str, new: str, field: str
) -> None:
    assert old in DBC
    with pytest.raises(SetupError, match=rf"signal\[0\]\.{field}: "):
        described(tmp_path, DBC.replace(old, new))


def test_a_frame_too_short_for_the_selector_is_of_no_page(tmp_path: Path) -> None:
    paged = DBC.replace(LINE, ' SG_ Page M : 56|8@1+ (1,0) [0|0] "" G\n' + LINE.replace("T0", "T0 m0"))
    frame = described(tmp_path, paged.replace("48|16@1-", "48|8@1-")).frame
    assert frame.fits(bytes(8))
    assert not frame.fits(bytes(7))
