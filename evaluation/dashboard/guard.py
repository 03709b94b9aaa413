"""Who may talk to the dashboard: a browser on this computer that has the page itself open, and nobody else.

A web page of another site may make a browser send requests to this computer, and may give its own name our
address (DNS rebinding). The ``Host`` of every request must therefore be a loopback name with our port, and
the ``Origin`` of the connection that takes orders must be the page's own.
"""

from __future__ import annotations

from urllib.parse import urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def is_own_host(host: str | None, port: int) -> bool:
    """Whether a ``Host`` header names this server.

    Args:
        host: The header; ``None`` if the request has none.
        port: The server's port.
    """
    return host is not None and host.lower() in {f"{name}:{port}" for name in LOOPBACK}


def is_own_origin(origin: str | None, host: str | None, port: int) -> bool:
    """Whether an ``Origin`` header names the page that this server served under the same name.

    Args:
        origin: The header; ``None`` if the request has none.
        host: The ``Host`` header.
        port: The server's port.
    """
    if origin is None or host is None or not is_own_host(host, port):
        return False
    parts = urlsplit(origin)
    return parts.scheme == "http" and parts.netloc.lower() == host.lower() and not parts.path


def headers(script_hash: str, style_hash: str) -> dict[str, str]:
    """Headers that let the page run its own script and style, talk to its own server, and nothing more.

    Args:
        script_hash: SHA-256 of the script, in base 64.
        style_hash: SHA-256 of the style sheet, in base 64.
    """
    policy = (
        "default-src 'none'",
        f"script-src 'sha256-{script_hash}'",
        f"style-src 'sha256-{style_hash}'",
        "connect-src 'self'",
        "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
    return {
        "Content-Security-Policy": "; ".join(policy),
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
