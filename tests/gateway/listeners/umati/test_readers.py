"""How fast the passwords of the OPC UA server can be guessed, on a clock that the test drives."""

import hashlib
from base64 import b64encode

import pytest
from asyncua.server.internal_server import InternalServer

from gateway.listeners.umati.readers import Readers, calling


def cheap_hash(password: str) -> str:
    """A hash in the form that `--make-password` prints, with the least work."""
    digest = hashlib.scrypt(password.encode(), salt=b"salt", n=2, r=1, p=1, dklen=32)
    return "$".join(("scrypt", "2", "1", "1", b64encode(b"salt").decode(), b64encode(digest).decode()))


class Door:
    """The readers, as asyncua asks them."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.server = InternalServer()
        names = {"anna": "right", "ben": "also right", **{f"user{n}": "of user" for n in range(10)}}
        users = {name: cheap_hash(password) for name, password in names.items()}
        self.readers = Readers(users, lambda: self.now_s)

    def opens(self, name: str | None, password: str | None, address: str = "") -> bool:
        called = calling.set(address)
        try:
            return self.readers.get_user(self.server, name, password) is not None
        finally:
            calling.reset(called)


@pytest.fixture
def door() -> Door:
    return Door()


def test_after_five_wrong_passwords_even_the_right_one_waits_longer_each_time(door: Door) -> None:
    for _ in range(5):
        assert not door.opens("anna", "wrong")
    for pause_s in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 300.0, 300.0):
        door.now_s += pause_s - 0.1
        assert not door.opens("anna", "right"), "not looked at yet"
        door.now_s += 0.2
        assert not door.opens("anna", "wrong"), "looked at, and the next pause begins"
    assert door.opens("ben", "also right"), "another name is not held up"
    door.now_s += 301.0
    assert door.opens("anna", "right")
    assert not door.opens("anna", "wrong")
    assert door.opens("anna", "right"), "the right one has ended it"


def test_a_reader_that_was_let_in_before_is_not_held_up_by_one_that_guesses(door: Door) -> None:
    assert door.opens("anna", "right")
    for _ in range(50):
        assert not door.opens("anna", "wrong")
    assert door.opens("anna", "right")
    assert not door.opens("ben", "right"), "one name's password opens for no other"


def test_twenty_passwords_a_minute_are_checked_of_all_names_together(door: Door) -> None:
    for n in range(20):
        assert not door.opens(f"user{n % 10}", "wrong")
    assert not door.opens("ben", "also right")
    door.now_s += 59.0
    assert not door.opens("ben", "also right")
    door.now_s += 1.5
    assert door.opens("ben", "also right")


def test_after_five_wrong_names_from_an_address_no_password_is_looked_at_from_there(door: Door) -> None:
    for n in range(9):
        assert not door.opens(f"nobody{n}", "wrong", f"192.168.1.{n % 2}")
    assert not door.opens("anna", "right", "192.168.1.0")
    assert door.opens("anna", "right", "192.168.1.1")


@pytest.mark.parametrize(
    ("name", "password"), [(None, None), ("anna", None), (None, "right"), ("eve", "right"), ("", "")]
)
def test_nobody_else_is_let_in_and_unknown_names_cost_nothing(
    door: Door, name: str | None, password: str | None
) -> None:
    for _ in range(100):
        assert not door.opens(name, password)
    assert door.opens("ben", "also right")
