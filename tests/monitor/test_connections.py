"""Clients of the live page's server that do not behave as a browser."""

from __future__ import annotations

import socket
import subprocess
import sys
from contextlib import ExitStack, closing, suppress
from http.client import HTTPConnection

from patience import PATIENCE

SCARCE = """
import resource
from egp_service.monitor import connections
from egp_service.monitor.web import bind, serve

resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))
connections.REQUEST_SECONDS = 0.5

class Listener:
    def deliver(self, _):
        pass

bound = bind("127.0.0.1", 0)
serve(Listener(), bound, "127.0.0.1", lambda: print(bound.getsockname()[1], flush=True))
"""


def test_clients_that_end_no_request_shut_nobody_out() -> None:
    """There are more of them than descriptors, and the server says nothing about them."""
    command = [sys.executable, "-c", SCARCE]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as server, ExitStack() as stack:
        stack.callback(server.kill)  # if the test fails
        assert server.stdout is not None
        address = ("127.0.0.1", int(server.stdout.readline()))
        slow = []
        for _ in range(150):
            slow.append(stack.enter_context(socket.create_connection(address, timeout=PATIENCE)))
            slow[-1].sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\nX: ")
        page = stack.enter_context(closing(HTTPConnection(*address, timeout=PATIENCE)))
        page.request("GET", "/")
        assert page.getresponse().status == 200
        for client in slow:
            with suppress(ConnectionResetError):
                assert client.recv(1) == b""
        server.terminate()
        _, said = server.communicate(timeout=PATIENCE)
    assert said == ""
