"""A Modbus device as its profile describes it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf, isfinite

from drivers.base import BadAnswer, Busy, Clock, DriverError, NoAnswer, Quality, Reading, Refused, WrongDevice
from drivers.faults import Fault, first_fault
from drivers.modbus.answers import BlockAnswers, Words
from drivers.modbus.bus import ModbusBus, NotAsked
from drivers.modbus.inputs import device_input
from drivers.modbus.numbers import AddressRange, Block, Span
from drivers.modbus.plan import ReadPlan
from drivers.modbus.profile import ChannelBlock, ModbusProfile
from drivers.modbus.settings import ModbusOptions
from drivers.readings import ReadingMaker, total
from drivers.text import Text

_ASK_REFUSED_AGAIN_S = 60.0
"""After this time the device is asked again for what it refused: a module may have been added or set up."""

_REFUSES_FOR_ONCE_S = 2.0
"""The same at first if it has been read before; each time it refuses again, twice as long."""

_CHECK_AGAIN_S = 60.0
"""After this time one more request asks for settings or type codes: somebody may have changed the module's settings."""

_SAME_UNIT_S = 2.0
"""How long the answers of a unit to a check that failed are kept: nobody exchanges a unit faster."""


class ModbusDevice:
    """One unit; `channels` maps names to the device's channel numbers, counted from 0.

    An address that the unit refuses, or does not answer while it answers others, takes the channels that need it, and
    no other.
    """

    def __init__(
        self,
        device: str,
        bus: ModbusBus,
        profile: ModbusProfile,
        unit: int,
        channels: Mapping[str, int],
        options: ModbusOptions,
        clock: Clock,
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._unit = bus, profile, unit
        bus.let_rest(unit, options.rest_ms / 1e3)
        self._offset, self._clock = options.address_offset, clock
        self._channels = {name: device_input(profile, number, self._offset) for name, number in channels.items()}
        self._maker = ReadingMaker({name: one.unit for name, one in self._channels.items()}, clock)
        inputs = self._channels.values()
        self._stated = [Block(w.function, w.address + self._offset, w.count) for w in profile.wholes]
        self._wholes = list(self._stated)
        self._tried: set[Block] = set()
        """Whole blocks that were asked for because a part was refused."""
        self._values = self._plan_values()
        self._faults = self._plan(())
        self._faults_after: list[Block] = []
        """The requests of values for which `_faults` was made."""
        self._codes = self._plan(one.code for one in inputs if one.code is not None)
        self._settings = self._plan((s.function, s.address + self._offset, 1) for s in profile.settings)
        self._spans: dict[str, Span] = {}
        self._checked = False
        """Whether the unit is known to match the profile."""
        self._told: dict[tuple[int, int], int] = {}
        """The settings and type codes that it was found to have."""
        self._checked_s = -inf
        """When it was asked for some of them last."""
        self._checks = 0
        self._answers = BlockAnswers()
        """To the requests of values."""
        self._fault_answers = BlockAnswers()
        self._check_answers = BlockAnswers()
        """To the requests of settings and type codes."""
        self._second_answers = BlockAnswers()
        """To the same requests, asked once more."""
        self._check_began_s = -inf
        self._check_answered_s = -inf
        """When it last answered a check, and has not been read since."""
        self._refused_since_s, self._refused_for_s = 0.0, _ASK_REFUSED_AGAIN_S
        self._was_silent = False
        """Whether it missed the last read and its repetitions: another unit may answer the next one."""
        self._was_asked = False
        """Whether it was read since it was last forgotten: what was asked before is too old."""

    async def connect(self) -> None:
        """Check the settings and the type codes of the channels in use, or just that the unit answers.

        Raises WrongDevice, or the bus's errors.
        """
        now = self._clock.monotonic()
        if not (self._settings.requests or self._codes.requests) and isfinite(self._check_answered_s):
            return  # it did, and the connection was lost before anything was read
        again = now - self._check_began_s < _SAME_UNIT_S
        if not again:
            self._check_began_s = now
            self._check_answers.clear()
            self._second_answers.clear()
            self._forget()
        missed = False
        try:
            await self._check(again)
            self._checked, self._check_answered_s = True, self._clock.monotonic()
            self._checked_s = self._check_answered_s
        except (NoAnswer, BadAnswer, Busy) as error:
            error.heard |= bool(self._check_answers)  # it has answered a part of it
            missed = True
            raise
        finally:
            if not missed:
                self._check_began_s = -inf

    async def _check(self, again: bool) -> None:
        if self._settings.requests:
            words = await self._fetch(self._settings, again)
            self._check_settings(words)
            if self._settings.refused:
                raise self._settings.error
            self._told.update(self._settings.needed(words))
        if self._codes.requests:
            words = await self._fetch(self._codes, again)
            self._spans = self._spans_of(words)
            self._told.update(self._codes.needed(words))
        elif not self._profile.settings:
            try:
                await self._ask(self._values.test, again=again)
            except NoAnswer:
                if not self._bus.is_late(self._unit):
                    self._values.test_missed()
                raise
            except Busy:
                raise
            except Refused:  # it answers; what it refuses is found when it is read
                pass

    def _check_settings(self, words: Words) -> None:
        for setting in self._profile.settings:
            found = words.get((setting.function, setting.address + self._offset))
            if found is not None and found != setting.equals:
                raise WrongDevice(
                    Text("modbus_setting", name=setting.name, found=found, profile=self._profile.name),
                    bus=self._bus.name,
                    device=self.device,
                    hint=setting.hint,
                )

    def _spans_of(self, words: Words) -> dict[str, Span]:
        """The scaling of each channel with a type code."""
        spans: dict[str, Span] = {}
        for channel, one in self._channels.items():
            codes = one.block.type_codes
            if codes is None or one.code is None or one.code in self._codes.refused:
                continue
            code = words[one.code[:2]]
            if code not in codes.spans:
                known = ", ".join(f"0x{c:04X}" for c in codes.spans)
                raise WrongDevice(
                    Text("modbus_type_code", code=code, index=one.index, profile=self._profile.name),
                    bus=self._bus.name,
                    device=self.device,
                    channel=channel,
                    hint=Text("modbus_set_input", known=known),
                )
            spans[channel] = codes.spans[code]
        return spans

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        """One reading per channel. After a silence the unit is checked again, because a different one may answer.

        again: continue with the request that was not answered
        """
        again &= self._was_asked
        if not again:
            self._answers.clear()
            self._fault_answers.clear()
            if self._was_silent:
                self._forget()
            elif self._refused_is_due:
                self._refused_for_s = min(2 * self._refused_for_s, _ASK_REFUSED_AGAIN_S)
                self._checked = not self._codes.refused  # without its type code a channel has no scaling
                self._reset_plans(silent=False)
        if not self._checked and (self._codes.requests or self._settings.requests):
            await self.connect()
        self._was_asked = True
        try:
            words, later = await self._read_words(again)
        except DriverError as error:
            error.heard |= bool(self._answers)  # it has answered a part of it
            self._was_silent = not error.heard
            error.heard |= self._clock.monotonic() - self._check_answered_s < _SAME_UNIT_S
            raise
        self._was_silent, self._check_answered_s = False, -inf
        lost = {**self._values.lost, **self._codes.lost}
        if not lost:
            self._refused_for_s = _REFUSES_FOR_ONCE_S
        values = {name: self._value(name, words, lost) for name in self._channels}
        for name, value in values.items():
            if self._faults.requests and not isinstance(value, Fault):
                values[name] = self._value(name, later, lost)
        return self._maker.make(values)

    async def _read_words(self, again: bool) -> tuple[Words, Words]:
        """What was read, and the same with the faults as they were after the values."""
        if self._values.is_refused:
            answer = await self._ask(self._values.test, again=again)
            self._values.reset()
            self._answers.add(self._values.test, answer)
        self._plan_faults()
        await self._answer(self._values, self._answers, again=again, in_order=bool(self._faults.requests))
        if self._values.refused and await self._finds_whole():
            self._plan_faults()
            await self._answer(self._values, self._answers, again=again, in_order=bool(self._faults.requests))
        if self._values.is_refused:
            raise self._values.error
        self._plan_faults()
        await self._answer(self._faults, self._fault_answers, again=again)
        words = self._answers.words(self._values.requests)
        later = {**words, **self._fault_answers.words(self._faults.requests)}
        self._values.join()
        return words, later

    async def _finds_whole(self) -> bool:
        """Whether the unit, which refuses a part of one of the profile's blocks, returns all of it at once; that is
        then asked for. Each block is tried once."""
        inputs = {id(one.block): one for one in self._channels.values() if one.value in self._values.refused}
        for one in inputs.values():
            whole = self._extent(one.block)
            is_long = whole.count > self._profile.max_registers
            if is_long or whole in self._tried or self._values.was_planned(whole):
                continue
            self._tried.add(whole)
            try:
                await self._ask(whole)
            except (NoAnswer, BadAnswer, Busy, Refused):
                continue
            self._wholes.append(whole)
            self._values = self._plan_values()
            self._bus.learn_whole(self._unit, _where(whole))
            return True
        return False

    def _extent(self, block: ChannelBlock) -> Block:
        """All values of a block of the profile."""
        places = [block.place(index, self._offset) for index in range(block.channels)]
        first = min(address for _, address, _ in places)
        return Block(places[0][0], first, max(address + width for _, address, width in places) - first)

    def _plan_faults(self) -> None:
        """Whenever the requests of values have changed."""
        if self._faults_after != self._values.requests:
            self._faults_after = list(self._values.requests)
            self._faults = self._plan(self._apart())

    async def _answer(self, plan: ReadPlan, answers: BlockAnswers, *, again: bool, in_order: bool = False) -> None:
        """Ask for what is missing in `answers`; a refused request of the plan is divided."""
        while True:
            request = answers.next_of(plan.requests if in_order else plan.surest_first, in_order=in_order)
            if request is None:
                return
            try:
                later = plan.requests[plan.requests.index(request) + 1 :] if in_order else ()
                answers.add(request, await self._ask(request, again=again), later)
                plan.answered(request)
            except NoAnswer as error:
                answers.missed(request)
                if self._leaves_out(plan, request, error):
                    continue
                raise self._with_gaps(error, plan.unused(request) if answers else "") from error
            except (BadAnswer, Busy):
                answers.missed(request)
                raise
            except Refused as error:
                if plan.is_certain(request, error):
                    plan.divide(request, error)
                    self._refused_since_s = self._clock.monotonic()
                elif not error.absent and plan.has_answered(request):  # it may be better in a moment
                    answers.missed(request)
                    raise Busy(error.what, bus=error.bus, device=error.device, hint=error.hint) from error

    @property
    def _refused_is_due(self) -> bool:
        """Whether what the unit has refused is to be asked for again."""
        refused = self._values.refused or self._codes.refused
        return bool(refused) and self._clock.monotonic() - self._refused_since_s >= self._refused_for_s

    def _leaves_out(self, plan: ReadPlan, request: Block, error: NoAnswer) -> bool:
        """Whether the request, which was not answered, is left out from now on, as the unit answers others."""
        counts = plan is self._values and bool(self._answers) and not isinstance(error, NotAsked)
        return (
            counts
            and not self._bus.is_late(self._unit)
            and plan.fell_silent(request, self._clock.monotonic(), hurried=error.hurried)
        )

    @property
    def asks_later(self) -> bool:
        """Whether something is to be asked for again by now: what it has left out, or what was checked."""
        now_s = self._clock.monotonic()
        return self._values.silent_due(now_s) is not None or (
            self._checked and bool(self._told) and now_s - self._checked_s >= _CHECK_AGAIN_S
        )

    async def ask_later(self) -> None:
        """Ask once for what was left out because the unit did not answer it; what it answers is read from now on. If
        there is nothing of that, ask once for some of what was checked; if that has changed, all is checked again.

        Raises the bus's errors, of what was left out other than silence.
        """
        request = self._values.silent_due(self._clock.monotonic())
        if request is None:
            await self._look_again()
            return
        answered = True
        try:
            try:
                await self._ask(request)
            except NoAnswer:
                if not self._bus.is_late(self._unit):
                    raise
                await self._ask(request, again=True)
        except NotAsked:
            return
        except NoAnswer:
            answered = False
        except (Refused, BadAnswer):  # it is not silent
            pass
        self._values.asked_silent(request, self._clock.monotonic(), answered=answered)

    async def _look_again(self) -> None:
        requests = (*self._settings.requests, *self._codes.requests)
        request = requests[self._checks % len(requests)]
        self._checks, self._checked_s = self._checks + 1, self._clock.monotonic()
        words = enumerate(await self._ask(request), start=request.address)
        found = {(request.function, address): word for address, word in words}
        self._checked &= all(self._told.get(place, word) == word for place, word in found.items())

    def _silence(self, request: Block) -> NoAnswer:
        """Why what this request is to read has no value, though the unit answers others."""
        return NoAnswer(
            Text("modbus_place_silent", unit=self._unit, where=_where(request)),
            bus=self._bus.name,
            device=self.device,
            hint=Text("modbus_has_address"),
        )

    def _with_gaps(self, error: NoAnswer, unused: str) -> NoAnswer:
        """The error of a request that reads unused addresses, too, to a unit that has answered others."""
        if not unused:
            return error
        hint = Text("modbus_gap", unused=unused)
        where = {"bus": error.bus, "device": error.device, "hint": hint}
        return NoAnswer(error.what, hurried=error.hurried, heard=error.heard, **where)

    async def _fetch(self, plan: ReadPlan, again: bool) -> Words:
        """What scales or judges all later values: without checksums it must be read alike twice in a row."""
        await self._answer(plan, self._check_answers, again=again)
        if plan.is_refused:
            raise plan.error
        if self._bus.has_checksum:
            return self._check_answers.words(plan.requests)
        await self._answer(plan, self._second_answers, again=again)
        if plan.is_refused:
            raise plan.error
        first, second = (plan.needed(a.words(plan.requests)) for a in (self._check_answers, self._second_answers))
        if first != second:
            self._check_answers, self._second_answers = self._second_answers, BlockAnswers()
            (function, address), *_ = (place for place in first if first[place] != second[place])
            raise BadAnswer(
                Text(
                    "modbus_two_answers",
                    unit=self._unit,
                    function=function,
                    address=address,
                    first=first[function, address],
                    second=second[function, address],
                ),
                bus=self._bus.name,
                device=self.device,
                hint=Text("modbus_disturbed"),
            )
        return second

    async def _ask(self, request: Block, *, again: bool = False) -> tuple[int, ...]:
        return await self._bus.read(self.device, self._unit, request, again=again)

    async def close(self) -> None:
        """Forget what is known about the unit: next time a different one may answer."""
        self._forget()

    def _forget(self) -> None:
        self._answers.clear()
        self._fault_answers.clear()
        self._was_asked = False
        self._spans, self._told, self._checked, self._was_silent = {}, {}, False, False
        self._refused_for_s = _ASK_REFUSED_AGAIN_S
        self._tried.clear()
        if self._wholes != self._stated:
            self._wholes = list(self._stated)
            self._values = self._plan_values()
        self._reset_plans()

    def _reset_plans(self, *, silent: bool = True) -> None:
        for plan in (self._values, self._codes, self._settings):
            plan.reset(silent=silent)

    def _plan(self, places: Iterable[AddressRange]) -> ReadPlan:
        profile = self._profile
        return ReadPlan(places, profile.max_registers, profile.max_gap, self._silence, tuple(self._wholes))

    def _plan_values(self) -> ReadPlan:
        return self._plan(place for one in self._channels.values() for place in (one.value, *one.faults))

    def _apart(self) -> Iterator[AddressRange]:
        """What must be read again after the values, so that a sensor that recovers in between is noticed.

        This applies where bits or status are read in another request than the value and the value cannot show it.
        """
        for one in self._channels.values():
            if one.block.sentinels or any(place in self._values.lost for place in (one.value, *one.faults)):
                continue
            yield from (place for place in one.faults if not self._values.read_together(place, one.value))

    def _value(self, channel: str, words: Words, lost: Mapping[AddressRange, DriverError]) -> float | Fault:
        one = self._channels[channel]
        block = one.block
        if lost and (error := next((lost[place] for place in one.all if place in lost), None)) is not None:
            return Fault(Quality.COMM_FAULT, error.advice)
        function, address, width = one.value
        raw = block.raw(one.index, [words[function, address + i] for i in range(width)])
        sentinel = block.sentinel_faults.get(raw)
        if (bits := block.fault_bits) is not None and one.bit is not None and words[one.bit[:2]]:
            return (
                bits.fault
                if sentinel is None
                else Fault(bits.fault.quality, Text("both_details", one=bits.fault.detail, other=sentinel.detail))
            )
        if (status := block.status) is not None and one.status is not None:
            code = status.code(one.index, words[one.status[:2]])
            if code not in status.good:
                unknown = Fault(Quality.SENSOR_FAULT, Text("status_undefined", code=code))
                return first_fault(status.rules, code) or unknown
        if sentinel is not None:
            return sentinel
        if not isfinite(raw):
            return Fault(Quality.SENSOR_FAULT, Text("sends_no_value", raw=raw))
        span = self._spans.get(channel)
        by_code = block.scaled_by == "type_code"
        value = self._spans[channel].apply(raw) if by_code else total(raw * block.scale, block.offset)
        if span is not None and not span.holds(value):
            ends = f"{span.low:g} to {span.high:g}"
            text = Text("beyond_input_range", value=value, unit=one.unit, ends=ends)
            return Fault(Quality.OUT_OF_RANGE, text)
        implausible = block.plausibility and block.plausibility.fault(value, one.unit)
        return implausible or value


def _where(request: Block) -> Text:
    return Text("modbus_request", function=request.function, address=request.address, count=request.count)
