"""TLS: the service proves who it is, and asks who the client is."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from service import START_S, Service

from graphfix import Client, Epoch, ServiceUnreachableError

OPENSSL = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]


def certificate(folder: Path, name: str, authority: str | None = None) -> tuple[Path, Path]:
    """A certificate with its key; of an authority unless one signs it."""
    files = folder / f"{name}.pem", folder / f"{name}.key"
    arguments = [*OPENSSL, "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    if authority is None:
        arguments += ["-addext", "keyUsage=critical,keyCertSign,cRLSign"]
    else:
        arguments += ["-CA", str(folder / f"{authority}.pem")]
        arguments += ["-CAkey", str(folder / f"{authority}.key")]
        arguments += ["-addext", "subjectAltName=DNS:localhost"]
        arguments += ["-addext", "basicConstraints=critical,CA:FALSE"]
    arguments += ["-out", str(files[0]), "-keyout", str(files[1])]
    subprocess.run(arguments, check=True, capture_output=True)
    return files


@pytest.fixture
def encrypted(tmp_path: Path) -> Iterator[Service]:
    """A service that asks its clients for certificates."""
    certificate(tmp_path, "ca")
    own, key = certificate(tmp_path, "service", "ca")
    arguments = ["--tls-certificate", str(own), "--tls-key", str(key)]
    arguments += ["--tls-client-ca", str(tmp_path / "ca.pem")]
    service = Service(tmp_path, more=arguments)
    service.url = f"https://localhost:{service.port}"
    service.start()
    yield service
    service.kill()


def test_both_sides_have_certificates(
    encrypted: Service, tmp_path: Path, epochs: list[Epoch]
) -> None:
    ca, (own, key) = tmp_path / "ca.pem", certificate(tmp_path, "rover", "ca")
    with Client(
        encrypted.url,
        ca_file=ca,
        certificate_file=own,
        private_key_file=key,
        patience_s=START_S,
    ) as client:
        session = client.create_session()
        answers = list(session.stream(epochs[:20]))
    assert [answer.seq for answer in answers] == [epoch.seq for epoch in epochs[:20]]
    certificate(tmp_path, "other")
    foreign = certificate(tmp_path, "stranger", "other")
    nothing: tuple[Path | None, Path | None] = (None, None)
    for authority, identity in (
        (ca, nothing),
        (ca, foreign),
        (tmp_path / "other.pem", (own, key)),
    ):
        with (
            Client(
                encrypted.url,
                ca_file=authority,
                certificate_file=identity[0],
                private_key_file=identity[1],
                patience_s=1,
            ) as client,
            pytest.raises(ServiceUnreachableError),
        ):
            client.create_session()
