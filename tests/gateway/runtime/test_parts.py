"""Parts of a program: they run together, end together, and can be exchanged while the others go on."""

import asyncio

import pytest

from gateway.runtime.parts import Part, Parts


class Told:
    """What parts do, in order."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def part(self, name: str, *, fails: bool = False) -> Part:
        """Says when it begins, ends, and when all have ended."""

        async def run() -> None:
            self.lines.append(f"{name} begins")
            if fails:
                raise OSError(name)
            try:
                await asyncio.Event().wait()
            finally:
                self.lines.append(f"{name} ends")

        async def after() -> None:
            self.lines.append(f"after {name}")

        return Part(name, run, after, works_s=1.0)


async def test_they_begin_in_their_order_and_what_is_left_is_done_when_all_have_ended() -> None:
    told, parts = Told(), Parts()
    parts.add(told.part("a"), told.part("b"))
    running = [parts.running]
    async with parts:
        await asyncio.sleep(0)
        running.append(parts.running)
    assert [*running, parts.running] == [False, True, False]
    assert told.lines[:2] == ["a begins", "b begins"]
    assert {*told.lines[2:4]} == {"a ends", "b ends"}
    assert {*told.lines[4:]} == {"after a", "after b"}


async def test_one_is_exchanged_for_another_of_its_name_and_the_rest_goes_on() -> None:
    told, parts = Told(), Parts()
    parts.add(told.part("a"), told.part("b"))
    async with parts:
        await asyncio.sleep(0)
        await parts.exchange(["a"], [told.part("a"), told.part("c")])
        await asyncio.sleep(0)
        assert told.lines == ["a begins", "b begins", "a ends", "a begins", "c begins"]
        assert set(parts.works_s) == {"a", "b", "c"}


async def test_one_that_fails_ends_all_and_its_error_is_raised() -> None:
    told, parts = Told(), Parts()
    parts.add(told.part("a"), told.part("b", fails=True))
    with pytest.raises(ExceptionGroup) as raised:
        async with parts:
            await asyncio.Event().wait()
    assert [str(error) for error in raised.value.exceptions] == ["b"]
    assert told.lines[2] == "a ends"


def test_a_name_is_given_once() -> None:
    told, parts = Told(), Parts()
    parts.add(told.part("a"))
    with pytest.raises(ValueError, match="'a'"):
        parts.add(told.part("a"))
