"""Who may give commands: only operators with their key, each command once, within its time, to this machine."""

import json
from collections.abc import Callable
from datetime import UTC, datetime

import pytest

from gateway.model.commands import UNPROVED, Command, CommandName, CommandOutcome
from gateway.model.text import plain
from gateway.telemetry.answers import CommandAnswer, CommandTerms
from gateway.telemetry.codec import decode_answer
from gateway.telemetry.command_door import CommandDoor, Entitled
from gateway.telemetry.command_signer import CommandSigner, SignedCommand
from gateway.telemetry.queries import AskedQuery, Replied, Work
from tests.benches.stepped_clock import SteppedClock

KEY, OTHER_KEY = b"a" * 64, b"b" * 64
ANNA = CommandSigner("anna", KEY)
PAUSE = CommandName.PAUSE
NOW = datetime(2026, 3, 2, 6, tzinfo=UTC)


class Gate:
    """A door, and the commands that it let in."""

    def __init__(self, machine: str = "mill", clock: SteppedClock | None = None) -> None:
        self.clock = clock or SteppedClock()
        self.given: list[tuple[Command, str]] = []
        entitled = {
            "anna": Entitled(KEY, frozenset({CommandName.MEASURE, PAUSE})),
            "ben": Entitled(OTHER_KEY, frozenset({CommandName.MEASURE})),
        }
        self.door = CommandDoor(machine, entitled, self._give, self.clock.monotonic)

    def _give(self, command: Command, refused: str) -> CommandOutcome:
        self.given.append((command, refused))
        return CommandOutcome(command, NOW, not refused, plain(refused or "done"))

    def terms(self) -> CommandTerms:
        return decode_answer(CommandTerms, self.door.answer(AskedQuery("", "", b"", b"")).payload)

    def send(self, signed: SignedCommand, below: str = "pause") -> CommandAnswer:
        replied = self.door.answer(AskedQuery(below, "", signed.payload, signed.signature))
        return signed.answered(replied.payload, replied.attachment or b"")


def test_an_operator_with_the_key_is_obeyed_and_answered_with_a_signature() -> None:
    gate = Gate()
    answer = gate.send(ANNA.sign(PAUSE, gate.terms(), "mill"))
    assert answer == CommandAnswer("mill", "pause", "anna", NOW.isoformat(), accepted=True, text="done")
    assert gate.given == [(Command(PAUSE, "anna"), "")]


def test_only_a_proved_command_is_any_work_and_one_by_caution_waits_for_nothing() -> None:
    gate = Gate()
    junk = AskedQuery("pause", "", b"{}", b"")
    at_once = 0
    for _ in range(50):
        assert isinstance(gate.door.sift(AskedQuery("", "", b"", b"")), Replied), "whoever asks for terms"
        try:
            found = gate.door.sift(junk)
        except ValueError:
            at_once += 1
        else:
            assert isinstance(found, Work)
            assert not found.urgent
    assert at_once == 40, "ten an hour are stored"
    for name, urgent in ((PAUSE, True), (CommandName.MEASURE, False)):
        signed = ANNA.sign(name, gate.terms(), "mill")
        found = gate.door.sift(AskedQuery(name.value, "", signed.payload, signed.signature))
        assert isinstance(found, Work)
        assert found.urgent is urgent
    assert gate.given == [], "not yet"


def wrong_key(gate: Gate) -> tuple[SignedCommand, str]:
    return CommandSigner("anna", OTHER_KEY).sign(PAUSE, gate.terms(), "mill"), "pause"


def unknown_name(gate: Gate) -> tuple[SignedCommand, str]:
    return CommandSigner("eve", KEY).sign(PAUSE, gate.terms(), "mill"), "pause"


def altered(gate: Gate) -> tuple[SignedCommand, str]:
    signed = ANNA.sign(CommandName.MEASURE, gate.terms(), "mill")
    payload = signed.payload.replace(b'"measure"', b'"pause"')
    assert payload != signed.payload
    return SignedCommand(payload, signed.signature, b""), "pause"


def of_another_name(gate: Gate) -> tuple[SignedCommand, str]:
    return ANNA.sign(CommandName.MEASURE, gate.terms(), "mill"), "pause"


def to_another_machine(gate: Gate) -> tuple[SignedCommand, str]:
    return ANNA.sign(PAUSE, gate.terms(), "lathe"), "pause"


def for_another_gateway_s_challenge(gate: Gate) -> tuple[SignedCommand, str]:
    return ANNA.sign(PAUSE, Gate("mill", gate.clock).terms(), "mill"), "pause"


def too_late(gate: Gate) -> tuple[SignedCommand, str]:
    signed = ANNA.sign(PAUSE, gate.terms(), "mill")
    gate.clock.spend(30.5)
    return signed, "pause"


def unknown_command(gate: Gate) -> tuple[SignedCommand, str]:
    return ANNA.sign(PAUSE, gate.terms(), "mill"), "dance"


def every_command(gate: Gate) -> tuple[SignedCommand, str]:
    return ANNA.sign(PAUSE, gate.terms(), "mill"), "*"


def no_json(gate: Gate) -> tuple[SignedCommand, str]:
    return SignedCommand(b"\xff{", b"", b""), "pause"


def no_such_field(gate: Gate) -> tuple[SignedCommand, str]:
    payload = ANNA.sign(PAUSE, gate.terms(), "mill").payload
    return SignedCommand(payload.replace(b"{", b'{"force":true,', 1), b"", b""), "pause"


def too_long(gate: Gate) -> tuple[SignedCommand, str]:
    return SignedCommand(b" " * 5000, b"", b""), "pause"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (wrong_key, "by and key are not those of an operator of this gateway"),
        (unknown_name, "by and key are not those of an operator of this gateway"),
        (altered, "by and key are not those of an operator of this gateway"),
        (of_another_name, "name = 'measure': this is 'pause'"),
        (to_another_machine, "machine = 'lathe': this is 'mill'"),
        (for_another_gateway_s_challenge, "not of this run of this gateway"),
        (too_late, "older than 30 s"),
        (unknown_command, "'dance': expected one of measure, pause, resume"),
        (every_command, "expected one of measure"),
        (no_json, "CommandRequest: "),
        (no_such_field, "force"),
        (too_long, "expected at most 4096"),
    ],
)
def test_what_is_not_proved_is_refused_and_obeyed_by_nobody(
    make: Callable[[Gate], tuple[SignedCommand, str]], said: str
) -> None:
    gate = Gate()
    signed, below = make(gate)
    with pytest.raises(ValueError) as refused:
        gate.send(signed, below)
    assert said in str(refused.value)
    if below in list(CommandName):
        [(command, why)] = gate.given
        assert command == Command(CommandName(below), UNPROVED), "to be stored in nobody's name"
        assert why.startswith(str(refused.value)[:300])
    else:
        assert gate.given == []


def test_a_refusal_says_in_whose_name_and_a_flood_of_them_is_stored_ten_times_an_hour() -> None:
    gate = Gate()

    def stranger() -> None:
        with pytest.raises(ValueError, match="by and key"):
            gate.send(CommandSigner("eve" * 99, KEY).sign(PAUSE, gate.terms(), "mill"))

    for _ in range(500):
        stranger()
    assert len(gate.given) == 10
    whole = "by and key are not those of an operator of this gateway; in the name of '" + "eve" * 21
    assert {why for _, why in gate.given} == {whole}
    gate.clock.spend(3599.0)
    stranger()
    assert len(gate.given) == 10
    gate.clock.spend(1.0)
    stranger()
    assert gate.given[10:] == [
        (Command(PAUSE, UNPROVED), whole + " (491 more were refused before, and are not stored)")
    ]


def test_while_a_refusal_cannot_be_stored_the_stranger_hears_the_same() -> None:
    def starting(command: Command, refused: str) -> CommandOutcome:
        raise OSError("the gateway is starting; give the command again")

    door = CommandDoor("mill", {"anna": Entitled(KEY, frozenset({PAUSE}))}, starting, SteppedClock().monotonic)
    terms = decode_answer(CommandTerms, door.answer(AskedQuery("", "", b"", b"")).payload)
    signed = CommandSigner("anna", OTHER_KEY).sign(PAUSE, terms, "mill")
    with pytest.raises(ValueError, match="by and key"):
        door.answer(AskedQuery("pause", "", signed.payload, signed.signature))


def test_a_command_counts_once() -> None:
    gate = Gate()
    signed = ANNA.sign(PAUSE, gate.terms(), "mill")
    assert gate.send(signed).accepted
    for _ in range(2):
        gate.clock.spend(20.0)
        with pytest.raises(ValueError, match=r"already given|older than 30 s"):
            gate.send(signed)
    assert [command.by for command, _ in gate.given] == ["anna", UNPROVED, UNPROVED]


def test_a_challenge_is_valid_for_thirty_seconds_after_many_others() -> None:
    gate = Gate()
    signed = ANNA.sign(PAUSE, gate.terms(), "mill")
    for _ in range(1000):
        gate.terms()
    gate.clock.spend(29.5)
    assert gate.send(signed).accepted


def test_what_the_configuration_does_not_allow_is_refused_in_the_operator_s_name() -> None:
    gate = Gate()
    answer = gate.send(CommandSigner("ben", OTHER_KEY).sign(PAUSE, gate.terms(), "mill"))
    assert (answer.accepted, answer.text) == (
        False,
        "ben may not give this command: it is not in `may` of their [[telemetry.operator]]",
    )
    assert gate.given == [(Command(PAUSE, "ben"), answer.text)]


def test_an_answer_that_is_not_signed_for_this_command_is_not_believed() -> None:
    gate = Gate()
    first, second = (ANNA.sign(PAUSE, gate.terms(), "mill") for _ in range(2))
    replied = gate.door.answer(AskedQuery("pause", "", first.payload, first.signature))
    for payload, attachment in ((replied.payload, b""), (replied.payload + b" ", replied.attachment or b"")):
        with pytest.raises(ValueError, match="does not come from a gateway with this key"):
            first.answered(payload, attachment)
    with pytest.raises(ValueError, match="does not come from a gateway with this key"):
        second.answered(replied.payload, replied.attachment or b"")


def test_strangers_are_logged_once_a_minute_without_their_keys(caplog: pytest.LogCaptureFixture) -> None:
    gate = Gate()
    for passed_s, lines in ((0.0, 1), (0.0, 1), (59.0, 1), (1.0, 2), (1.0, 2)):
        gate.clock.spend(passed_s)
        signed = CommandSigner("eve", OTHER_KEY).sign(PAUSE, gate.terms(), "mill")
        with pytest.raises(ValueError):
            gate.send(signed)
        assert len(caplog.messages) == lines
        assert "'eve'" in caplog.messages[-1]
        for secret in (OTHER_KEY.decode(), signed.signature.hex(), json.loads(signed.payload)["challenge"]):
            assert secret not in caplog.text
