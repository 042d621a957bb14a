"""The server of the page: viser behind a check of who asks. Only the process of the page imports this.

viser serves whoever connects, takes another port where one is taken, and opens a tunnel to the
internet when a page asks for it. Here it gets a socket that is bound already, and every request is
checked first: a page of another site in the same browser names its ``Origin``, or, by a name of its
own for this computer, its ``Host``.
"""

import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Any

import viser
from viser import _messages
from websockets.asyncio import server as websocket_server
from websockets.http11 import Request, Response

from airtact.errors import InvalidInput

HERE = ("127.0.0.1", "localhost")
"""Names of this computer, by which a page without a token is served."""


@dataclass(frozen=True)
class Guard:
    """Decides who is served.

    Attributes
    ----------
    token : first part of the path of every address, or None for pages on this computer only.
    """

    token: str | None

    def path_within(self, path: str, host: str, origin: str | None) -> str | None:
        """Return the path behind the token, or None where the request is turned away.

        Parameters
        ----------
        path : that is asked for, such as ``"/"``.
        host : name and port by which this server was addressed.
        origin : of the page that asks, such as ``"http://127.0.0.1:8940"``; programs that are no
            browser have none.
        """
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return None
        if self.token is None:
            return path if host.rpartition(":")[0] in HERE or host in HERE else None
        first, _, rest = path.lstrip("/").partition("/")
        known = secrets.compare_digest(first.partition("?")[0].encode(), self.token.encode())
        return f"/{rest}" if known else None


def bound_socket(port: int, host: str) -> socket.socket:
    """Bind a socket; raise "link_in_use" where another program listens there."""
    if not 0 <= port <= 65535:
        raise InvalidInput(
            f"port {port} does not exist; give 1 to 65535, or 0 for any that is free.",
            code="out_of_range",
        )
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
        bound.listen()
    except OSError as error:
        bound.close()
        sentence = f"the page cannot listen at {host}, port {port}: {error.strerror or error}; take another port."
        raise InvalidInput(sentence, code="link_in_use") from None
    return bound


def start_server(port: int, host: str) -> tuple[viser.ViserServer, str]:
    """Start viser behind a guard, and return it with the address of the page.

    Raises
    ------
    InvalidInput
        When the port is taken or does not exist, or viser is another version than this was written for.
    """
    bound = bound_socket(port, host)
    guard = Guard(None if host in HERE else secrets.token_urlsafe(24))
    with _served_by(bound, guard) as asked:
        server = viser.ViserServer(host=host, port=bound.getsockname()[1], verbose=False)
    if not asked:
        server.stop()
        bound.close()
        sentence = f"viser {viser.__version__} does not let requests be checked: install viser 1.1."
        raise InvalidInput(sentence, code="extra_missing")
    for message in (
        _messages.ShareUrlRequest,
        _messages.ShareUrlDisconnect,
    ):  # no tunnel to the internet
        server._websock_server.unregister_handler(message)
    name = socket.gethostname() if host in ("0.0.0.0", "") else host
    path = "" if guard.token is None else f"{guard.token}/"
    return server, f"http://{name}:{bound.getsockname()[1]}/{path}"


@contextmanager
def _served_by(bound: socket.socket, guard: Guard) -> Iterator[list[bool]]:
    """Let the server that viser starts inside listen at a socket and ask a guard; the list says that it does."""
    serve, asked = websocket_server.serve, []

    def guarded(
        handler: Any, host: str, port: int, *, process_request: Any, **settings: Any
    ) -> Any:
        asked.append(True)
        return serve(
            handler, sock=bound, process_request=_checked(process_request, guard), **settings
        )

    websocket_server.serve = guarded
    try:
        yield asked
    finally:
        websocket_server.serve = serve


def _checked(
    answer: Callable[[Any, Request], Response | None], guard: Guard
) -> Callable[[Any, Request], Any]:
    def check(connection: Any, request: Request) -> Response | None:
        path = guard.path_within(
            request.path, request.headers.get("Host", ""), request.headers.get("Origin")
        )
        if path is None:
            words = (
                "This page is not served to other sites, nor without the token in its address.\n"
            )
            return connection.respond(HTTPStatus.FORBIDDEN, words)
        return answer(connection, replace(request, path=path))

    return check
