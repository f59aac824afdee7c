"""A session that hears gateways: what they published before it came, what they publish, and that they are gone."""

import json

import pytest

from gateway.config.telemetry import Telemetry
from gateway.telemetry.subscriber.hearing import Hearing
from tests.benches.free_port import free_port
from tests.benches.telemetry_peer import ROOT, problem, telemetry
from tests.benches.waits import until

EVENT, ALIVE = f"{ROOT}/event", f"{ROOT}/alive"


class HeardGateways:
    def __init__(self, *, interested: bool = True) -> None:
        self.texts, self.lives, self._interested = list[str](), list[tuple[str, bool]](), interested

    def hear(self, key: str, payload: bytes) -> None:
        if key == EVENT:
            self.texts.append(json.loads(payload)["text"])

    def life(self, key: str, alive: bool) -> bool:
        self.lives.append((key, alive))
        return self._interested


def hearing(port: int, ear: HeardGateways) -> Hearing:
    return Hearing(Telemetry(listen=(), connect=(f"tcp/127.0.0.1:{port}",)), ear.hear, ear.life)


async def test_what_a_gateway_published_before_and_publishes_and_its_life_are_heard() -> None:
    port, ear = free_port(), HeardGateways()
    with hearing(port, ear):
        async with telemetry(port) as publisher:
            publisher.publish(problem("before"))
            await until(lambda: "before" in ear.texts)
            with hearing(port, later := HeardGateways()):
                await until(lambda: "before" in later.texts)
                publisher.publish(problem("now"))
                await until(lambda: "now" in later.texts)
        await until(lambda: (ALIVE, False) in ear.lives)
    assert ear.lives == [(ALIVE, True), (ALIVE, False)]


async def test_a_machine_of_no_interest_is_not_asked_for_what_it_published() -> None:
    port, ear = free_port(), HeardGateways(interested=False)
    async with telemetry(port) as publisher:
        publisher.publish(problem("before"))
        with hearing(port, asks := HeardGateways()):
            await until(lambda: "before" in asks.texts)
        with hearing(port, ear):
            await until(lambda: ear.lives)
            publisher.publish(problem("now"))
            await until(lambda: "now" in ear.texts)
    assert ear.texts == ["now"]


def test_there_is_no_session_for_questions_before_it_is_entered() -> None:
    with pytest.raises(OSError, match="not connected"):
        hearing(1, HeardGateways()).at("mill")
