"""Files that a connection's settings name: what is read from them, and what is said of one that cannot be used."""

import ssl
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.credential_files import secret_in, trust_in
from tests.benches.plant_authority import PlantAuthority


def test_a_secret_is_read_without_the_white_space_around_it(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text(" größer \n", encoding="utf-8")
    assert secret_in("password_file", file) == "größer"


@pytest.mark.parametrize(("content", "said"), [(None, "No such file"), (b"\xff\xfe", "can't decode byte 0xff")])
def test_a_secret_that_cannot_be_read_is_named_with_its_field(tmp_path: Path, content: bytes | None, said: str) -> None:
    file = tmp_path / "token"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SetupError) as raised:
        secret_in("token_file", file, "drive")
    assert (raised.value.device, raised.value.field, raised.value.what.code) == (
        "drive",
        ("token_file",),
        "file_useless",
    )
    assert raised.value.what.values["path"] == str(file)
    assert said in str(raised.value.what.values["why"])


def test_only_the_authority_of_the_file_is_trusted(tmp_path: Path) -> None:
    plant = PlantAuthority(tmp_path / "plant")
    context = trust_in(plant.path)
    assert [each["subject"] for each in context.get_ca_certs()] == [((("commonName", "plant"),),)]
    assert (context.verify_mode, context.check_hostname) == (ssl.CERT_REQUIRED, True)


@pytest.mark.parametrize("content", [None, "no certificate"])
def test_an_authority_that_cannot_be_used_is_named(tmp_path: Path, content: str | None) -> None:
    file = tmp_path / "authority.pem"
    if content is not None:
        file.write_text(content)
    with pytest.raises(SetupError) as raised:
        trust_in(file)
    assert (raised.value.field, raised.value.what.code) == (("authority",), "file_useless")
    assert raised.value.what.values["path"] == str(file)
