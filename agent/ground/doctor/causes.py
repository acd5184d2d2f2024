"""What a failed dial means, in words that say what to do: the tables. Pure.

The words on the left are those of Python's socket and ssl modules with OpenSSL 3, as seen with Zenoh 1.10.2.
"""

from __future__ import annotations

import errno
from datetime import datetime

NO_HOST = "no such host; write the computer's address as a number in listen"
HANGS = (
    "takes the call, but no handshake follows: its agent hangs, or it listens on tcp/, not tls/; start it again, with "
    "this fleet file"
)
NO_TLS = "is no agent of a secured fleet: something else has that port; end it, or give the robot another port"

PORT = {
    errno.ECONNREFUSED: "nobody listens there; start its agent, or compare listen in its fleet file with ours",
    errno.EHOSTUNREACH: "no way to that computer; look whether it is on and its cable in, and compare the address",
    errno.ENETUNREACH: "no way to that network; give this computer an address in it, or correct listen",
}
SILENT = "no answer in a second; look whether its computer is on, a firewall is in between, or listen is wrong"

# Of the robot's certificate, as we see it: a part of what OpenSSL says -> what is wrong with it.
THEIRS = {
    "unable to get local issuer certificate": "its certificate is of another authority than our ca.pem; {copy}",
    "self-signed certificate": "its certificate is of another authority than our ca.pem; {copy}",
    "certificate signature failure": "its certificate is of another authority than our ca.pem; {copy}",
    "certificate has expired": "its certificate has expired by our clock ({now}); {renew}",
    "certificate is not yet valid": "its certificate is not valid yet by our clock ({now}); set that, or {renew}",
    "mismatch": "its certificate is not for {host}, where it listens; {renew}",
    "certificate purpose": "its certificate is not for listening (it lacks serverAuth); {renew}",
}
COPY = "give both computers the files of one and the same authority"
RENEW = "make another: aucamp keys --only"

# Of our certificate, as the robot says: alert of TLS -> what it has against it.
OURS = {
    "CERTIFICATE_REQUIRED": "wants a certificate, and we showed none; copy one here, and name it with --as",
    "UNKNOWN_CA": "does not know the authority of our certificate; {copy}",
    "DECRYPT_ERROR": "our certificate is of another authority, of the same name as its own; {copy}",
    "CERTIFICATE_EXPIRED": "holds our certificate for expired or not valid yet; set its clock, or renew ours",
    "UNSUPPORTED_CERTIFICATE": "our certificate is not for dialling (it lacks clientAuth); {renew}",
}


def port_cause(error: OSError) -> str:
    """Why nobody could be reached at all."""
    if isinstance(error, TimeoutError):
        return SILENT
    return PORT.get(error.errno or 0, f"cannot be dialled: {error.strerror or error}; correct listen")


def theirs(verify_message: str, host: str, now: datetime) -> str:
    """What is wrong with the certificate that was shown to us."""
    for sign, cause in THEIRS.items():
        if sign in verify_message:
            return cause.format(copy=COPY, renew=RENEW, host=host, now=f"{now:%Y-%m-%d %H:%M} UTC")
    return f"its certificate cannot be used ({verify_message}); {RENEW}"


def ours(reason: str, shown: bool) -> str | None:
    """What is wrong with the certificate that we showed; None where it only wants one, and we have none to show."""
    for sign, cause in OURS.items():
        if sign in reason:
            return None if sign == "CERTIFICATE_REQUIRED" and not shown else cause.format(copy=COPY, renew=RENEW)
    return f"turns our certificate down ({reason}); {RENEW}"
