"""Why TLS refuses a host, in the words of a user who has to mend it."""

from __future__ import annotations

import ssl

WRONG_HOST = (62, 64)
"""OpenSSL's codes for a certificate of another name, and of another address."""

UNKNOWN_ISSUER = (18, 19, 20, 21)
"""OpenSSL's codes for a certificate that is signed by itself, or by an issuer that is not known."""

NOT_TLS = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE")
"""OpenSSL's reasons where what answers does not speak TLS."""

ALERT = b"\x15\x03"
"""How the answer of a host begins that expects TLS and was spoken to without it."""


class HandshakeError(Exception):
    """TLS refuses the host; asking again would not help."""


def handshake_error(error: ssl.SSLError, host: str) -> HandshakeError | None:
    """What `error` of a handshake with `host` means; None where the next try may do better."""
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code in WRONG_HOST:
            return HandshakeError(f"its certificate is for another host, not for {host}")
        hint = ""
        if error.verify_code in UNKNOWN_ISSUER:
            hint = "; if you trust it, name a file with its certificate in SSL_CERT_FILE"
        return HandshakeError(f"its certificate is not trusted: {error.verify_message}{hint}")
    if error.reason in NOT_TLS:
        return HandshakeError("the server does not speak TLS at this port; try http://")
    return None
