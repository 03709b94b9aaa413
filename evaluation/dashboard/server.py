"""Serves the page and its connection; runs in a thread of its own and only ever asks the session."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import json
import re
import socket
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from importlib.resources import files
from typing import Any

from aiohttp import WSMsgType, web

from evaluation.dashboard.guard import headers, is_own_host, is_own_origin
from evaluation.live.screen import session_state
from evaluation.live.session import LabSession
from hilbrace.errors import HilbraceError, InputError

ADDRESS = "127.0.0.1"

PORT = 8765

LARGEST_MESSAGE = 2048
"""Bytes of the longest order that is read."""

LARGEST_REQUEST = 1024
"""Bytes of the longest request body that is read; no request needs one."""

MOST_PAGES = 8
"""Pages that may be open at once."""

PERIOD_S = 1 / 30
"""Time between two states that a page gets [s]."""

SLOW_S = 2.0
"""A page that takes no news for so long is closed [s]."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Dashboard:
    """The server of one session's page.

    Args:
        session: What is shown.
        port: Port on the loopback address; 0 for any that is free.

    Raises:
        InputError: The port is taken.
    """

    def __init__(self, session: LabSession, port: int = PORT) -> None:
        self._session = session
        self._socket = _listen(port)
        self.port: int = self._socket.getsockname()[1]
        self._page = files("evaluation.dashboard").joinpath("page.html").read_text("utf-8")
        self._headers = headers(_hash_of("script", self._page), _hash_of("style", self._page))
        self._pages: set[web.WebSocketResponse] = set()
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dashboard", daemon=True)
        self._done: asyncio.Event | None = None

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{ADDRESS}:{self.port}/"

    def start(self) -> None:
        """Begin to serve; returns as soon as the page can be opened."""
        self._thread.start()
        self._ready.wait(10.0)

    def stop(self) -> None:
        """Close all pages and end the thread."""
        if self._done is not None:
            self._loop.call_soon_threadsafe(self._done.set)
        self._thread.join(10.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.run_until_complete(_end_tasks())
            self._loop.run_until_complete(self._loop.shutdown_default_executor())
            self._loop.close()
            self._socket.close()

    async def _serve(self) -> None:
        self._done = asyncio.Event()
        app = web.Application(client_max_size=LARGEST_REQUEST, middlewares=[self._guard])
        app.router.add_get("/", self._show)
        app.router.add_get("/live", self._connect)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        await web.SockSite(runner, self._socket).start()
        self._ready.set()
        await self._done.wait()
        for page in list(self._pages):
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(page.close(), 1.0)
        await runner.cleanup()

    @property
    def _guard(self) -> Any:
        @web.middleware
        async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
            if not is_own_host(request.headers.get("Host"), self.port):
                return web.Response(status=421, text="This page is served to this computer only.\n")
            if (request.content_length or 0) > LARGEST_REQUEST:
                return web.Response(status=413, text="Nothing that large is read here.\n")
            return await handler(request)

        return guard

    async def _show(self, request: web.Request) -> web.StreamResponse:
        return web.Response(text=self._page, content_type="text/html", headers=self._headers)

    async def _connect(self, request: web.Request) -> web.StreamResponse:
        origin, host = request.headers.get("Origin"), request.headers.get("Host")
        if not is_own_origin(origin, host, self.port):
            return web.Response(status=403, text="Only the page itself may connect.\n")
        if len(self._pages) >= MOST_PAGES:
            return web.Response(status=503, text="Too many pages are open.\n")
        page = web.WebSocketResponse(timeout=1.0, max_msg_size=LARGEST_MESSAGE, heartbeat=5.0, compress=False)
        await page.prepare(request)
        self._pages.add(page)
        sender = asyncio.create_task(self._send(page, request.transport))
        try:
            async for message in page:
                if message.type == WSMsgType.TEXT:
                    await self._answer(page, message.data)
                elif message.type == WSMsgType.BINARY:
                    await page.close(code=1003)
        finally:
            self._pages.discard(page)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sender
        return page

    async def _send(self, page: web.WebSocketResponse, line: asyncio.Transport | None) -> None:
        """Send the state thirty times a second, with what is new of the curves.

        A page that does not take it is cut off, since a polite goodbye would wait for it as well.
        """
        knee = force = 0
        while not page.closed:
            knee, knee_anew, knee_rows = self._session.analysis.knee_curve.since(knee)
            force, force_anew, force_rows = self._session.analysis.force_curve.since(force)
            state = session_state(self._session) | {
                "knee_curve": {"anew": knee_anew, "rows": knee_rows},
                "force_curve": {"anew": force_anew, "rows": force_rows},
            }
            if not await _deliver(page, {"state": state}):
                if line is not None:
                    line.abort()
                return
            await asyncio.sleep(PERIOD_S)

    async def _answer(self, page: web.WebSocketResponse, text: str) -> None:
        """Carry out an order in another thread, and say what became of it."""
        try:
            order = _order(text)
            done = await self._loop.run_in_executor(None, self._carry_out, order)
            answer = {"text": done, "ok": True}
        except HilbraceError as fault:
            answer = {"text": f"{fault.what}: {fault.hint}", "ok": False}
        await _deliver(page, {"answer": answer})

    def _carry_out(self, order: dict[str, str]) -> str:
        session = self._session
        match order:
            case {"order": "start"}:
                return session.begin_take()
            case {"order": "stop"}:
                return session.end_take()
            case {"order": "condition", "name": name}:
                return session.choose_condition(name)
            case {"order": "standing"}:
                return _result(session.record_standing())
            case {"order": "zero"}:
                return _result(session.zero_plates())
        raise InputError("unknown order", where="page", hint="reload the page")


async def _end_tasks() -> None:
    """End whatever connections have left behind."""
    left = asyncio.all_tasks() - {asyncio.current_task()}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)


def _listen(port: int) -> socket.socket:
    try:
        return socket.create_server((ADDRESS, port))
    except OSError as fault:
        raise InputError(
            f"cannot open the dashboard: {fault.strerror}",
            where=f"{ADDRESS}:{port}",
            hint="close the other session, or choose another --port (0: any that is free)",
        ) from None


def _order(text: str) -> dict[str, str]:
    try:
        order = json.loads(text)
    except ValueError:
        order = None
    if not isinstance(order, dict) or not all(isinstance(value, str) for value in order.values()):
        raise InputError("unknown order", where="page", hint="reload the page")
    return order


def _result(future: "Future[str]") -> str:
    return future.result()


async def _deliver(page: web.WebSocketResponse, content: dict[str, Any]) -> bool:
    """Send a message, unless the page is gone or does not listen."""
    try:
        await asyncio.wait_for(page.send_str(json.dumps(content, allow_nan=False)), SLOW_S)
    except (ConnectionError, TimeoutError):
        return False
    return True


def _hash_of(element: str, page: str) -> str:
    """SHA-256 of the content of the page's only element of a kind, in base 64."""
    found = re.search(rf"<{element}>(.*?)</{element}>", page, re.DOTALL)
    content = found.group(1) if found else ""
    return base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
