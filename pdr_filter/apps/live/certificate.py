"""Certificate for this machine, because browsers provide motion sensors only to https pages."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

# iOS takes no certificate of a server that is valid for longer than 825 days.
_VALID = timedelta(days=800)
NAMES = ("authority.pem", "server.pem")


def certificate(folder: Path, host: str) -> Path:
    """Return the path of server.pem in a folder, with the key and the certificate for a host name or address.

    authority.pem is the certificate of its authority. Both files are kept while the host is the same.
    """
    import trustme

    authority, server = (folder / name for name in NAMES)
    if not server.exists() or host not in _hosts(server):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        ca = trustme.CA(organization_name="pdr-filter live")
        made = ca.issue_cert(*dict.fromkeys([host, "localhost", "127.0.0.1"]), not_after=datetime.now(UTC) + _VALID)
        with os.fdopen(os.open(server, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
            file.write(made.private_key_and_cert_chain_pem.bytes())
        ca.cert_pem.write_to_path(authority)
    return server


def _hosts(server: Path) -> set[str]:
    """Return the host names and addresses of a certificate, none if the file is damaged."""
    from cryptography.x509 import SubjectAlternativeName, load_pem_x509_certificates

    try:
        own = load_pem_x509_certificates(server.read_bytes())[0]
    except ValueError:
        return set()
    return {str(name.value) for name in own.extensions.get_extension_for_class(SubjectAlternativeName).value}
