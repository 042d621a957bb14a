"""The server of the page: viser, with a check of every request. Only the page imports this.

viser serves any client, takes another port if its port is taken, and opens a tunnel to the internet
when a page requests it. Here it gets a socket that is already bound, and every request is checked
first. A page of another site in the same browser is recognised by its ``Origin``, or by its
``Host`` if it uses another name for this computer.
"""

import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from typing import Any

import viser
from viser import _messages
from websockets.asyncio import server as websocket_server
from websockets.http11 import Request, Response

from airtact.errors import InvalidInput

# Names of this computer under which a page without a token is served.
HERE = ("127.0.0.1", "localhost")


def path_within(path: str, host: str, origin: str | None, token: str | None) -> str | None:
    """Return the path after the token, or None if the request must be rejected.

    Parameters
    ----------
    path : requested path, such as ``"/"``.
    host : name and port of this server in the request.
    origin : origin of the page that sends the request, such as ``"http://127.0.0.1:8940"``; None
        for programs other than browsers.
    token : required first part of the path; None if only this computer is served.
    """
    if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return None
    if token is None:
        return path if host.rpartition(":")[0] in HERE or host in HERE else None
    first, _, rest = path.lstrip("/").partition("/")
    # Constant-time comparison: the time must not reveal the token.
    valid = secrets.compare_digest(first.partition("?")[0].encode(), token.encode())
    return f"/{rest}" if valid else None


def start_server(port: int, host: str) -> tuple[viser.ViserServer, str]:
    """Start viser with a check of requests, and return it with the address of the page.

    Raises
    ------
    InvalidInput
        If the port is taken or does not exist, or the version of viser is not supported.
    """
    bound = _bound_socket(port, host)
    port = bound.getsockname()[1]
    token = None if host in HERE else secrets.token_urlsafe(24)
    with _guarding(bound, token) as served:
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not served:
        server.stop()
        bound.close()
        raise InvalidInput(
            f"viser {viser.__version__} does not support checking requests: install viser 1.1.",
            code="extra_missing",
        )
    # Disable the tunnel to the internet.
    for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(message)
    name = socket.gethostname() if host in ("0.0.0.0", "") else host
    path = "" if token is None else f"{token}/"
    return server, f"http://{name}:{port}/{path}"


def _bound_socket(port: int, host: str) -> socket.socket:
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
        raise InvalidInput(
            f"the page cannot listen at {host}, port {port}: {error.strerror or error}; "
            "take another port.",
            code="link_in_use",
        ) from None
    return bound


@contextmanager
def _guarding(bound: socket.socket, token: str | None) -> Iterator[list[bool]]:
    """Give viser's server a socket and a check of requests; yield whether viser used them."""
    # viser has no public way to pass either, so the function that it calls is replaced for now.
    serve = websocket_server.serve
    served = []

    def guarded(
        handler: Any, host: str, port: int, *, process_request: Any, **settings: Any
    ) -> Any:
        served.append(True)
        check = _checked(process_request, token)
        return serve(handler, sock=bound, process_request=check, **settings)

    websocket_server.serve = guarded
    try:
        yield served
    finally:
        websocket_server.serve = serve


def _checked(
    answer: Callable[[Any, Request], Response | None], token: str | None
) -> Callable[[Any, Request], Any]:
    def check(connection: Any, request: Request) -> Response | None:
        host = request.headers.get("Host", "")
        path = path_within(request.path, host, request.headers.get("Origin"), token)
        if path is None:
            return connection.respond(
                HTTPStatus.FORBIDDEN,
                "This page is not served to other sites, nor without the token in its address.\n",
            )
        response = answer(connection, replace(request, path=path))
        if response is not None:
            # Pages of other sites must not show this one in a frame and lure clicks onto it.
            response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            response.headers["X-Frame-Options"] = "DENY"
        return response

    return check
