"""Certificates, password and settings for the peer on node-opcua (peers/node_opcua)."""

from dataclasses import dataclass
from pathlib import Path

from asyncua.crypto.cert_gen import setup_self_signed_certificate
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from drivers.sinumerik.settings import SinumerikSettings

TIMEOUT_S = 60.0
"""A busy computer may need this long for another program's answer."""


@dataclass(frozen=True)
class NodeOpcUaSite:
    """A peer that speaks Basic256Sha256 with SignAndEncrypt only, to one user and the gateway's certificate."""

    folder: Path

    @property
    def password(self) -> Path:
        return self.folder / "password"

    @property
    def arguments(self) -> tuple[Path, ...]:
        """The arguments of server.js."""
        names = ("pki", "peer.pem", "peer_key.pem", "gateway.der")
        return tuple(self.folder / name for name in names)

    def settings(self, url: str, name: str = "gateway", *, subscribe_s: float = 0.0) -> SinumerikSettings:
        """The settings of the gateway, or of another owner of a certificate."""
        return SinumerikSettings(
            url=url,
            security="Basic256Sha256",
            user="gateway",
            password_file=self.password,
            certificate=self.folder / f"{name}.der",
            private_key=self.folder / f"{name}_key.pem",
            server_certificate=self.folder / "peer.der",
            subscribe_s=subscribe_s,
            timeout_s=TIMEOUT_S,
        )


async def secured(folder: Path, *names: str) -> NodeOpcUaSite:
    """Makes the peer's certificate and one for each name."""
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    for name in ("peer", *names):
        uri = "urn:peer:server" if name == "peer" else "urn:talc:gateway"
        await setup_self_signed_certificate(
            folder / f"{name}_key.pem", folder / f"{name}.der", uri, "localhost", usage, {"commonName": name}
        )
    certificate = x509.load_der_x509_certificate((folder / "peer.der").read_bytes())
    (folder / "peer.pem").write_text(certificate.public_bytes(Encoding.PEM).decode())
    site = NodeOpcUaSite(folder)
    site.password.write_text("secret\n")
    return site
