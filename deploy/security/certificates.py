"""Generation of certificates with the library ``cryptography``."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Final, final

from deploy.errors import InputError

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

_EARLIER: Final = timedelta(minutes=5)
"""Certificates are valid from shortly before their creation, since clocks of hosts differ."""


@final
@dataclass(frozen=True, slots=True)
class CertificatePair:
    """A certificate and its private key, PEM."""

    certificate: bytes
    key: bytes


@final
class Authority:
    """Certificate authority of a run.

    The private key stays in memory and is never written, so that no certificate can be signed later.

    Args:
        days: Validity of the certificates, days.

    Attributes:
        certificate: Certificate of the authority, PEM.
        until: End of the certificates' validity.

    Raises:
        InputError: The library is not installed.
    """

    def __init__(self, days: int) -> None:
        try:
            from cryptography.hazmat.primitives.asymmetric import ec
        except ImportError:
            raise InputError(
                "mdms keys needs the package cryptography: pip install 'mdms-emulator[keys]', or use --passwords"
            ) from None
        from cryptography import x509

        self._key = ec.generate_private_key(ec.SECP256R1())
        now = datetime.now(UTC)
        self._from = now - _EARLIER
        self.until = now + timedelta(days=days)
        self._name = _name("mdms run authority")
        usage = x509.KeyUsage(
            digital_signature=False,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            key_cert_sign=True,
            crl_sign=False,
            encipher_only=False,
            decipher_only=False,
        )
        made = (
            self._builder(self._name, self._key)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
        )
        self.certificate = self._signed(made)

    def server(self, name: str, hosts: Iterable[str], *, connects: bool = False) -> CertificatePair:
        """Create the certificate of a server with these names and addresses.

        Args:
            name: Common name.
            hosts: Names and addresses of the server's host.
            connects: Whether the server connects to others as well, and is a client there.
        """
        from cryptography import x509
        from cryptography.x509.oid import ExtendedKeyUsageOID as Usage

        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        usages = [Usage.SERVER_AUTH, Usage.CLIENT_AUTH] if connects else [Usage.SERVER_AUTH]
        return self._made(name, usages, names)

    def client(self, name: str) -> CertificatePair:
        """Create the certificate of a client; valid for client authentication only."""
        from cryptography.x509.oid import ExtendedKeyUsageOID

        return self._made(name, [ExtendedKeyUsageOID.CLIENT_AUTH])

    def _made(
        self, name: str, usages: list[x509.ObjectIdentifier], *more: x509.ExtensionType
    ) -> CertificatePair:
        from cryptography import x509
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ec

        key = ec.generate_private_key(ec.SECP256R1())
        made = (
            self._builder(_name(name), key)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        )
        for extension in more:
            made = made.add_extension(extension, critical=False)
        pem = key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
        return CertificatePair(self._signed(made), pem)

    def _builder(self, name: x509.Name, key: EllipticCurvePrivateKey) -> x509.CertificateBuilder:
        from cryptography import x509

        return (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(self._from)
            .not_valid_after(self.until)
        )

    def _signed(self, made: x509.CertificateBuilder) -> bytes:
        from cryptography.hazmat.primitives import hashes, serialization

        return made.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def _name(common: str) -> x509.Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _host(text: str) -> x509.GeneralName:
    """Return a host's address or name as an X.509 name.

    Raises:
        InputError: The text is neither an address nor a name in ASCII.
    """
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        pass
    try:
        return x509.DNSName(text)
    except ValueError:
        raise InputError(f"--host {text}: must be a host's name in ASCII, or its address") from None
