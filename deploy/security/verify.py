"""Check of certificates before Zenoh uses them, since Zenoh reports a bad certificate only as a missing answer."""

from __future__ import annotations

import ssl
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from deploy.errors import InputError
from deploy.security.roles import PLANT, ROUTER

if TYPE_CHECKING:
    from bus.transports.zenoh import Certificate


def check_certificate(identity: Certificate, role: str) -> None:
    """Check a certificate by a TLS handshake with itself in memory: plant and router as servers, others as clients.

    Raises:
        InputError: The certificate has expired, another authority signed it, the key doesn't match, or the role
            differs.
    """
    try:
        shown = _shaken(identity, as_server=role in (PLANT, ROUTER))
    except ssl.SSLCertVerificationError as error:
        raise InputError(f"{identity.certificate}: {error.verify_message}: mdms keys makes another") from None
    except (ssl.SSLError, OSError) as error:
        reason = getattr(error, "reason", None) or error.strerror or error
        text = str(reason).lower().replace("_", " ")
        raise InputError(f"{Path(identity.certificate).parent}: no certificate and its key: {text}") from None
    if shown != role:
        raise InputError(f"{identity.certificate}: is {shown}'s, not {role}'s")


def _shaken(identity: Certificate, *, as_server: bool) -> str | None:
    """Return the common name that one side has shown and the other has verified."""
    server, client = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False  # the name by which the plant is reached is checked by its clients
    client.verify_mode = ssl.CERT_REQUIRED if as_server else ssl.CERT_NONE
    server.verify_mode = ssl.CERT_NONE if as_server else ssl.CERT_REQUIRED
    for side in (server, client):
        side.load_cert_chain(identity.certificate, identity.key)
        side.load_verify_locations(identity.authority)
    there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    sides = (server.wrap_bio(there, back, server_side=True), client.wrap_bio(back, there))
    for _ in range(4):  # each has its say twice at most
        for side in reversed(sides):
            with suppress(ssl.SSLWantReadError):
                side.do_handshake()
    verified = cast("dict[str, Any]", sides[1 if as_server else 0].getpeercert() or {})
    names = {name: value for part in verified.get("subject", ()) for name, value in part}
    return names.get("commonName")
