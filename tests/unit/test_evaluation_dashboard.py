"""Who may look and who may order: the page's own browser on this computer, and nobody else."""

from __future__ import annotations

import asyncio
import json
import socket
import threading

import aiohttp
import pytest

from evaluation.dashboard import server as served
from evaluation.dashboard.guard import is_own_host, is_own_origin
from evaluation.dashboard.server import LARGEST_MESSAGE, MOST_PAGES, Dashboard
from evaluation.live.session import LabSession
from evaluation.live.settings import LabSettings
from hilbrace.errors import InputError
from tests.unit.evaluation_devices import INFO, ScriptedSource, stream


@pytest.fixture
def dashboard(tmp_path):
    settings = LabSettings.model_validate(
        {
            "baseline": "Unbraced",
            "conditions": [{"name": "Unbraced"}, {"name": "Firm <b>&"}],
            "protocol": {"side": "left", "hip": {"model": "marker"}},
        }
    )
    session = LabSession(settings, tmp_path / "out", [ScriptedSource([list(stream(50))])])
    page = Dashboard(session, 0)
    session.start()
    page.start()
    yield page
    page.stop()
    session.stop()


def request(page, path="/", **headers):
    """Status and body of a request with whatever headers."""

    async def ask():
        async with (
            aiohttp.ClientSession() as client,
            client.get(page.url.rstrip("/") + path, headers=headers) as reply,
        ):
            return reply.status, await reply.text(), dict(reply.headers)

    return asyncio.run(ask())


def converse(page, *messages, origin=None, count=1):
    """What the page's connection answers to orders; raises if it is refused."""

    async def talk():
        own = page.url.rstrip("/") if origin is None else origin
        async with (
            aiohttp.ClientSession() as client,
            client.ws_connect(page.url + "live", origin=own) as line,
        ):
            for message in messages:
                await line.send_str(message)
            answers = []
            while len(answers) < count:
                reply = await line.receive(timeout=20)
                if reply.type is not aiohttp.WSMsgType.TEXT:
                    return line.close_code
                content = json.loads(reply.data)
                answers += [content["answer"]] if "answer" in content else []
            return answers

    return asyncio.run(talk())


def test_it_listens_on_the_loopback_address_alone(dashboard):
    assert dashboard._socket.getsockname()[0] == "127.0.0.1"
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for other in others - {"127.0.0.1"}:
        if not other.startswith("127."):
            with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
                socket.create_connection((other, dashboard.port), timeout=2).close()


def test_the_page_is_one_file_without_outside_addresses(dashboard):
    status, text, headers = request(dashboard)
    assert status == 200
    assert "http://" not in text
    assert "https://" not in text
    assert "src=" not in text
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "connect-src 'self'" in policy
    assert "unsafe" not in policy
    assert headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "10.0.0.1:{port}"]
)
@pytest.mark.parametrize("path", ["/", "/live"])
def test_other_host_names_are_refused(dashboard, host, path):
    status, text, _ = request(dashboard, path, Host=host.format(port=dashboard.port))
    assert status == 421
    assert "script" not in text


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "http://localhost:{port}",
               "http://127.0.0.1:{port}@evil.example", "http://127.0.0.1:{port}/x"]
)  # fmt: skip
def test_other_origins_may_not_connect(dashboard, origin):
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        converse(dashboard, origin=origin.format(port=dashboard.port))
    assert refused.value.status == 403


def test_no_origin_may_not_connect(dashboard):
    status, *_ = request(dashboard, "/live", Connection="Upgrade", Upgrade="websocket")
    assert status == 403


def test_local_names_are_the_same_host():
    assert is_own_host("LOCALHOST:8765", 8765)
    assert is_own_host("[::1]:8765", 8765)
    assert not is_own_host(None, 8765)
    assert is_own_origin("http://localhost:8765", "localhost:8765", 8765)
    assert not is_own_origin("http://localhost:8765", "127.0.0.1:8765", 8765)


def test_large_orders_end_the_connection(dashboard):
    assert converse(dashboard, "x" * (LARGEST_MESSAGE + 1)) == aiohttp.WSCloseCode.MESSAGE_TOO_BIG


def test_large_requests_are_not_read(dashboard):
    with socket.create_connection(("127.0.0.1", dashboard.port), timeout=10) as line:
        line.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{dashboard.port}\r\nContent-Length: 99999999\r\n\r\n".encode()
        )
        assert b" 413 " in line.recv(4096)
    with socket.create_connection(("127.0.0.1", dashboard.port), timeout=10) as line:
        line.sendall(b"GET / HTTP/1.1\r\nX: " + b"y" * 100_000)
        assert b" 400 " in line.recv(4096)


def test_other_methods_and_paths_are_unknown(dashboard):
    assert request(dashboard, "/etc/passwd")[0] == 404
    assert request(dashboard, "/%2e%2e/server.py")[0] == 404


@pytest.mark.parametrize(
    "order", ["", "[]", "null", "{", '{"order": 5}', '{"order": "reboot"}', '{"order": {"a": 1}}', "\ud7ff"]
)
def test_strange_orders_are_answered_and_forgotten(dashboard, order):
    (answer,) = converse(dashboard, order)
    assert answer == {"text": "unknown order: reload the page", "ok": False}


def test_orders_reach_the_session(dashboard):
    wrong, chosen, stopped = converse(
        dashboard,
        json.dumps({"order": "condition", "name": "Other"}),
        json.dumps({"order": "condition", "name": "Firm <b>&"}),
        json.dumps({"order": "stop"}),
        count=3,
    )
    assert not wrong["ok"]
    assert "no condition" in wrong["text"]
    assert chosen == {"text": "Firm <b>& is next", "ok": True}
    assert stopped["text"].startswith("no take is running")


def test_only_so_many_pages_may_be_open(dashboard):
    async def crowd():
        async with aiohttp.ClientSession() as client:
            own = dashboard.url.rstrip("/")
            lines = [await client.ws_connect(dashboard.url + "live", origin=own) for _ in range(MOST_PAGES)]
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                await client.ws_connect(dashboard.url + "live", origin=own)
            for line in lines:
                await line.close()
            return refused.value.status

    assert asyncio.run(crowd()) == 503


def test_a_page_that_does_not_listen_holds_nothing_up(dashboard, monkeypatch):
    """Its connection fills and is closed; the devices and the other pages go on."""
    monkeypatch.setattr(served, "SLOW_S", 0.2)
    monkeypatch.setattr(served, "PERIOD_S", 0.0)
    with socket.create_connection(("127.0.0.1", dashboard.port), timeout=10) as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.sendall(
            f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{dashboard.port}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nOrigin: {dashboard.url.rstrip('/')}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        gone = threading.Event()
        for _ in range(600):
            if dashboard._pages:
                break
            gone.wait(0.01)
        for _ in range(1500):
            if not dashboard._pages:
                break
            gone.wait(0.01)
        assert not dashboard._pages
    (answer,) = converse(dashboard, json.dumps({"order": "stop"}))
    assert not answer["ok"]


def test_a_port_in_use_is_a_named_error(dashboard):
    with pytest.raises(InputError, match="cannot open the dashboard"):
        Dashboard(dashboard._session, dashboard.port)


def test_what_the_page_gets(dashboard):
    async def first():
        async with (
            aiohttp.ClientSession() as client,
            client.ws_connect(dashboard.url + "live", origin=dashboard.url.rstrip("/")) as line,
        ):
            while True:
                state = json.loads((await line.receive(timeout=20)).data)["state"]
                if state["devices"][0]["frames"] == 50:
                    return state

    state = asyncio.run(first())
    assert state["devices"][0]["name"] == INFO.source
    assert state["devices"][0]["samples"] == 250
    assert state["loss"] == {"received": 300, "lost": 0, "dropped": 0}
    assert state["fault"] in ("no standing trial yet", "no device sends markers")
    assert state["conditions"] == ["Unbraced", "Firm <b>&"]
    assert not state["recording"]["on"]
