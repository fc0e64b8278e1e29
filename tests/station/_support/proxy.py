"""A real nginx in front of an operator station."""

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from tests._support.robot import LIMIT_S, PROJECT

NGINX, OPENSSL = shutil.which("nginx"), shutil.which("openssl")
needs_nginx = pytest.mark.skipif(
    NGINX is None or OPENSSL is None,
    reason="THE PAGE BEHIND A PROXY IS NOT TESTED: on Debian: apt-get install nginx-light openssl",
)
DOCUMENTED_STATION = "127.0.0.1:8080"
CONFIGURATION = """
daemon off;
master_process off;
pid nginx.pid;
error_log stderr warn;
events {{}}
http {{
    access_log off;
    client_body_temp_path body; proxy_temp_path proxied;
    fastcgi_temp_path fastcgi; uwsgi_temp_path uwsgi; scgi_temp_path scgi;
    server {{
        listen 127.0.0.1:{listen};
        {tls}
        {location}
    }}
}}
"""
TLS = "ssl_certificate cert.pem; ssl_certificate_key key.pem;"


def documented_location() -> str:
    """The location that docs/operator-station.md gives for nginx."""
    text = (PROJECT / "docs" / "operator-station.md").read_text()
    return text.partition("```nginx\n")[2].partition("```")[0]


def free_port() -> int:
    """A port of this machine that nobody uses now."""
    with closing(socket.create_server(("127.0.0.1", 0))) as found:
        return int(found.getsockname()[1])


@contextmanager
def nginx(folder: Path, port: int, location: str, *, tls: bool = False) -> Iterator[None]:
    """Run nginx on a port.

    Args:
        folder: a new folder for its files.
        port: where it listens.
        location: what it serves.
        tls: whether it ends TLS, with a certificate that nobody knows.
    """
    folder.mkdir()
    if tls:
        make_certificate(folder)
    listen = f"{port} ssl" if tls else f"{port}"
    text = CONFIGURATION.format(listen=listen, tls=TLS if tls else "", location=location)
    (folder / "nginx.conf").write_text(text)
    command = [str(NGINX), "-p", str(folder), "-c", "nginx.conf", "-e", "stderr"]
    with (folder / "said").open("wb") as said, subprocess.Popen(command, stderr=said) as process:
        try:
            until_it_listens(port, process, folder / "said")
            yield
        finally:
            process.terminate()
            print((folder / "said").read_text())


def make_certificate(folder: Path) -> None:
    """Write a key and a certificate for this machine."""
    made = ["-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    named = ["-subj", "/CN=127.0.0.1", "-keyout", "key.pem", "-out", "cert.pem"]
    subprocess.run([str(OPENSSL), "req", *made, *named], cwd=folder, check=True, capture_output=True)


def until_it_listens(port: int, process: "subprocess.Popen[bytes]", said: Path) -> None:
    """Wait until something listens on a port of this machine."""
    deadline_s = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline_s and process.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            time.sleep(0.02)
        else:
            return
    raise AssertionError(f"nginx does not listen: {said.read_text()}")
