"""The server of the page, which checks every request. Only the page's process imports it.

A page from another site in the same browser is recognised by its ``Origin``, or by its ``Host`` if
it reaches this computer under another name.
"""

import secrets
import socket
import ssl
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from threading import Thread

from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from airtact.errors import InvalidInput
from airtact.hands.tracking.receivers import SILENT, bound_socket

# Names of this computer under which the page is served without a token.
HERE = ("127.0.0.1", "localhost")


def path_within(path: str, host: str, origin: str | None, token: str | None) -> str | None:
    """Return the part of the path after the token, or None if the request must be rejected.

    Parameters
    ----------
    path : requested path, such as ``"/"``.
    host : host and port of this server as given in the request.
    origin : origin of the page that sends the request, such as ``"http://127.0.0.1:8940"``; None
        for programs other than browsers.
    token : required first part of the path; None if only this computer is served.
    """
    if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return None
    if token is None:
        return path if host.rpartition(":")[0] in HERE or host in HERE else None
    first, _, rest = path.lstrip("/").partition("/")
    # Compare in constant time, so that the response time does not reveal the token.
    valid = secrets.compare_digest(first.partition("?")[0].encode(), token.encode())
    return f"/{rest}" if valid else None


def start_server(
    port: int,
    host: str,
    page: str,
    serve_page: Callable[[ServerConnection], None],
    certificate: Path | None = None,
) -> tuple[Server, str]:
    """Serve a page and its websocket in threads; return the server and the page's address.

    Parameters
    ----------
    port, host : port and address to listen on; port 0 selects a free port.
    page : the page as HTML.
    serve_page : function called with each websocket, in a separate thread.
    certificate : PEM file with a certificate and its key, required for HTTPS.

    Raises
    ------
    InvalidInput
        If the port is in use or invalid, or the certificate cannot be read.
    """
    context = None
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(certificate)
        except OSError as fault:
            raise InvalidInput(
                f"the certificate {certificate} cannot be used ({fault}): use a PEM file that "
                "contains the certificate and its key.",
                code="file_unreadable",
            ) from None
    bound = bound_socket(socket.SOCK_STREAM, host, port)
    bound.listen()
    port = bound.getsockname()[1]
    token = None if host in HERE else secrets.token_urlsafe(24)

    def answer(connection: ServerConnection, request: Request) -> Response | None:
        name = request.headers.get("Host", "")
        path = path_within(request.path, name, request.headers.get("Origin"), token)
        if path is None:
            return connection.respond(
                HTTPStatus.FORBIDDEN,
                "This page cannot be used by other sites, or without the token in its address.\n",
            )
        if path.partition("?")[0] != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "This server has only one page.\n")
        if "Upgrade" in request.headers:
            return None
        # Prevent other sites from embedding this page in a frame and luring clicks onto it.
        headers = Headers(
            {
                "Content-Type": "text/html; charset=utf-8",
                "Content-Length": str(len(page.encode())),
                "Content-Security-Policy": "frame-ancestors 'none'",
                "X-Frame-Options": "DENY",
                "Cache-Control": "no-store",
                "Connection": "close",
            }
        )
        return Response(HTTPStatus.OK, "OK", headers, page.encode())

    server = serve(
        serve_page,
        sock=bound,
        ssl=context,
        process_request=answer,
        max_size=2**16,
        compression=None,
        close_timeout=1,
        logger=SILENT,
    )
    Thread(target=server.serve_forever, daemon=True).start()
    name = socket.gethostname() if host in ("0.0.0.0", "") else host
    path = "" if token is None else f"{token}/"
    return server, f"{'http' if context is None else 'https'}://{name}:{port}/{path}"
