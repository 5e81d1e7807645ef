"""A chat-completion server on loopback that answers, and fails, as a test says.

    with ScriptedServer(answers("{}"), resets()) as server:
        ...  # two requests to server.base_url
    assert server.requests[0].json["temperature"] == 0

A behaviour is a function of an :class:`Exchange`; each request takes the next one, then
``otherwise``. A request that nothing was scripted for gets a status 500, and leaving the ``with``
block tells of it.
"""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections import deque
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

MODEL = "scripted"
LONGEST = 30.0  # seconds that one behaviour may take
PATIENCE = 10.0  # seconds that a client may take to send or to read
LARGEST = 64 * 2**20  # bytes that one behaviour may send


@dataclass
class Request:
    """What a client sent, and what became of the answer."""

    method: str
    path: str
    headers: dict  # names in lower case
    body: bytes
    sent: int = 0  # bytes of the answer's body
    abandoned: bool = False  # the client closed before it had all

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def prompt(self):
        """The text of all messages."""
        parts = []
        for message in self.json["messages"]:
            content = message["content"]
            if isinstance(content, str):
                parts.append(content)
            else:
                parts.extend(part["text"] for part in content if part["type"] == "text")
        return "\n".join(parts)


@dataclass
class Exchange:
    """One request and the ways to answer it."""

    request: Request
    stopped: threading.Event
    _handler: BaseHTTPRequestHandler = field(repr=False)

    def sleep(self, seconds):
        """Waits; says whether the server still runs."""
        return not self.stopped.wait(min(seconds, LONGEST))

    def start(self, status=200, *, length=None, kind="application/json", headers=None):
        """Sends status and headers."""
        self._handler.send_response(status)
        self._handler.send_header("Content-Type", kind)
        if length is not None:
            self._handler.send_header("Content-Length", str(length))
        for name, value in (headers or {}).items():
            self._handler.send_header(name, value)
        self._handler.end_headers()

    def write(self, data):
        """Sends some of the body."""
        self._handler.wfile.write(data)
        self.request.sent += len(data)

    def send(self, body, status=200, **options):
        """Sends a whole answer: bytes, text, or an object as JSON."""
        if not isinstance(body, bytes):
            body = (body if isinstance(body, str) else json.dumps(body)).encode()
        self.start(status, length=len(body), **options)
        self.write(body)

    def reset(self):
        """Closes the connection with an RST."""
        connection = self._handler.connection
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        socket.close(connection.detach())


def completion(content, *, finish_reason="stop", refusal=None, usage=None, model=MODEL):
    """The JSON object of a chat completion."""
    message = {"role": "assistant", "content": content, "refusal": refusal}
    return {
        "id": "chatcmpl-scripted",
        "object": "chat.completion",
        "created": 1_700_000_000,
        "model": model,
        "system_fingerprint": "fp_scripted",
        "choices": [
            {"index": 0, "message": message, "finish_reason": finish_reason, "logprobs": None}
        ],
        "usage": usage or {"prompt_tokens": 10, "completion_tokens": 5, "total_tokens": 15},
    }


def sends(body, status=200, **options):
    """Any body: bytes, text, or an object as JSON."""
    return lambda exchange: exchange.send(body, status, **options)


def answers(content, **options):
    """A completion with this text; options as those of :func:`completion`."""
    if not isinstance(content, str):
        content = json.dumps(content)
    return sends(completion(content, **options))


def answers_by(function):
    """A completion with the text that ``function(request)`` gives."""
    return lambda exchange: exchange.send(completion(function(exchange.request)))


def answers_nothing(content=""):
    """A completion whose text is empty, or null for ``None``."""
    return sends(completion(content))


def refuses(text="I cannot help with that."):
    """A completion with a refusal in place of the text."""
    return sends(completion(None, refusal=text))


def truncates(content):
    """A completion that stopped at the limit of tokens."""
    return sends(completion(content, finish_reason="length"))


def fails(status, message="scripted failure", *, retry_after=None):
    """An HTTP error with OpenAI's error object."""
    headers = {} if retry_after is None else {"Retry-After": str(retry_after)}
    return sends(_error(message, status), status, headers=headers)


def echoes_the_key(status=401):
    """An HTTP error whose message repeats the Authorization header."""

    def behave(exchange):
        header = exchange.request.headers.get("authorization", "")
        exchange.send(_error(f"Incorrect API key provided: {header}", status), status)

    return behave


def tells_an_error(message="the model is overloaded"):
    """Status 200 with an error object in place of a completion."""
    return sends(_error(message, "server_error"))


def has_no_choices():
    """A completion with an empty list of choices."""
    return sends({**completion(""), "choices": []})


def has_wrong_types():
    """A completion in which every part has another type than it should."""
    return sends({**completion(""), "choices": "none", "usage": [1], "model": 7, "created": "now"})


def is_slow(seconds, then):
    """Another behaviour, later; the server's close interrupts the wait."""

    def behave(exchange):
        if exchange.sleep(seconds):
            then(exchange)

    return behave


def dribbles(content, *, pause=0.01):
    """A completion that comes one byte at a time."""

    def behave(exchange):
        body = json.dumps(completion(content)).encode()
        exchange.start(length=len(body))
        for byte in body:
            exchange.write(bytes([byte]))
            if not exchange.sleep(pause):
                return

    return behave


def cuts(content, *, after=40):
    """A completion that ends early: fewer bytes come than its length says."""

    def behave(exchange):
        body = json.dumps(completion(content)).encode()
        exchange.start(length=len(body))
        exchange.write(body[:after])

    return behave


def resets(*, after_headers=False):
    """The connection is reset, before or after the headers."""

    def behave(exchange):
        if after_headers:
            exchange.start(length=1000)
            exchange.write(b"{")
        exchange.reset()

    return behave


def sends_html():
    """A proxy's login page with status 200."""
    return sends("<!doctype html><title>Sign in</title><p>Sign in", kind="text/html")


def sends_garbage():
    """Bytes that are neither JSON nor UTF-8, said to be JSON."""
    return sends(bytes(range(255, 127, -1)) * 8)


def never_ends(*, megabytes=8, pause=0.0):
    """A body without a length that goes on for so many megabytes (at most 64)."""

    def behave(exchange):
        exchange.start()
        exchange.write(b'{"choices": [{"message": {"content": "')
        while exchange.request.sent < min(megabytes * 2**20, LARGEST):
            exchange.write(b"x" * 65536)
            if not exchange.sleep(pause):
                return

    return behave


def _error(message, code):
    return {"error": {"message": message, "type": "scripted", "param": None, "code": code}}


class ScriptedServer:
    """The server, from its construction to :meth:`close` or for ``at_most`` seconds.

    Args:
        behaviours: For one request each, in order.
        otherwise: For every request after them.
        at_most: Seconds after which it closes by itself.
        keep_alive: Whether a connection takes several requests; a behaviour then tells the length.
        tls: With what it speaks TLS.
        port: Where it listens; by default where nobody does.
        models: What it lists; by default one model.
    """

    def __init__(
        self, *behaviours, otherwise=None, at_most=60.0, keep_alive=False, tls=None, port=0,
        models=None,
    ):  # fmt: skip
        self.accepted = 0
        self.requests, self.unscripted = [], []
        self.model = MODEL
        self.models = models or {"object": "list", "data": [{"id": MODEL, "object": "model"}]}
        self._behaviours, self._otherwise = deque(behaviours), otherwise
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._connections = set()
        self._server = _Server(("127.0.0.1", port), _KeepingHandler if keep_alive else _Handler)
        if tls is not None:
            self._server.socket = tls.wrap_socket(self._server.socket, server_side=True)
        self.port = self._server.server_address[1]
        self._server.script = self
        self.base_url = f"http://127.0.0.1:{self.port}/v1"
        self._loop = threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True)
        self._loop.start()
        self._watchdog = threading.Timer(at_most, self._end)
        self._watchdog.daemon = True
        self._watchdog.start()

    def then(self, *behaviours):
        """Adds behaviours for the next requests."""
        with self._lock:
            self._behaviours.extend(behaviours)

    def close_connections(self):
        """Closes those that are open, and returns when that has been done."""
        with self._lock:
            for connection in self._connections:
                _shut(connection)

    @property
    def environment(self):
        """The variables that a planner reads."""
        return {"DURA_LLM_BASE_URL": self.base_url, "DURA_LLM_MODEL": self.model}

    def close(self):
        """Interrupts what is under way and joins all threads."""
        self._watchdog.cancel()
        self._end()
        if self._watchdog is not threading.current_thread():
            self._watchdog.join()

    def _end(self):
        with self._lock:
            first = not self._stopped.is_set()
            self._stopped.set()
        self.close_connections()
        if first:
            self._server.shutdown()
            self._server.server_close()
            self._loop.join()

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        self.close()
        if kind is None:
            assert not self.unscripted, f"nothing was scripted for {self.unscripted}"

    def _behaviour(self, request):
        with self._lock:
            self.requests.append(request)
            if self._behaviours:
                return self._behaviours.popleft()
            if self._otherwise is None:
                self.unscripted.append(f"{request.method} {request.path}")
            return self._otherwise or fails(500, "nothing was scripted for this request")

    def _opened(self, connection):
        with self._lock:
            self._connections.add(connection)
            self.accepted += 1
            if self._stopped.is_set():
                _shut(connection)

    def _closed(self, connection):
        with self._lock:
            self._connections.discard(connection)


def _shut(connection):
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # the client, or a behaviour, closed it already


class _Server(ThreadingHTTPServer):
    daemon_threads = False  # closing joins them

    def handle_error(self, request, client_address):
        """Prints nothing for connections that a client, or the close, ended."""
        import sys

        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    timeout = PATIENCE

    def setup(self):
        super().setup()
        self.server.script._opened(self.connection)

    def finish(self):
        self.server.script._closed(self.connection)
        super().finish()

    def do_POST(self):
        script = self.server.script
        length = int(self.headers.get("Content-Length", 0))
        headers = {name.lower(): value for name, value in self.headers.items()}
        request = Request(self.command, self.path, headers, self.rfile.read(length))
        behave = script._behaviour(request)
        try:
            behave(Exchange(request, script._stopped, self))
        except (ConnectionError, TimeoutError):
            request.abandoned = True

    def do_GET(self):
        """The list of models needs no script, and is not recorded."""
        if not self.path.partition("?")[0].endswith("/models"):
            self.do_POST()
            return
        request = Request(self.command, self.path, {}, b"")
        Exchange(request, self.server.script._stopped, self).send(self.server.script.models)

    def log_message(self, *_):
        pass


class _KeepingHandler(_Handler):
    protocol_version = "HTTP/1.1"
