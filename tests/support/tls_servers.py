"""A proxy that tunnels, and a certificate that is its own authority, as fixtures to import."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading

import pytest


class Tunnel:
    """A proxy that connects every client to one address, whatever it asks for, or declines."""

    def __init__(self, target, status="200 OK"):
        self.asked, self._target, self._status = [], target, status
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://me:pass@127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            head = b""
            while not head.endswith(b"\r\n\r\n"):
                head += client.recv(1)
            self.asked.append(head.decode().lower().split("\r\n"))
            client.sendall(f"HTTP/1.1 {self._status}\r\n\r\n".encode())
            if not self._status.startswith("200"):
                client.close()
                continue
            target = socket.create_connection(self._target)
            for pair in ((client, target), (target, client)):
                threading.Thread(target=self._pass_on, args=pair, daemon=True).start()

    @staticmethod
    def _pass_on(source, sink):
        with source, sink:
            try:
                while data := source.recv(65536):
                    sink.sendall(data)
                sink.shutdown(socket.SHUT_WR)
            except OSError:
                return

    def close(self):
        self._server.close()


@pytest.fixture
def tunnel():
    """``tunnel(address)`` starts a proxy to that address, until the test ends."""
    started = []

    def start(*given):
        started.append(Tunnel(*given))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """Key and certificate of ``model.test``, which is its own authority."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificate")
    file = tmp_path_factory.mktemp("tls") / "model.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
         "/CN=model.test", "-addext", "subjectAltName=DNS:model.test", "-keyout", file, "-out",
         file.with_suffix(".crt")], check=True, capture_output=True,
    )  # fmt: skip
    file.write_text(file.read_text() + file.with_suffix(".crt").read_text())
    return file
