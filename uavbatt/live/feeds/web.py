"""The feed for a browser: one page, server-sent events, JSON, Prometheus metrics and a health check.

    /  the page     /events  SSE     /now.json     /metrics     /healthz (503 when stale)     /register_service

It reads the board that the loop publishes, never the estimator, and runs in a thread of its own. It is read only. If a
token is set, every path but /healthz needs `?token=` or `Authorization: Bearer`.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import ipaddress
import json
import math
import os
import re
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from uavbatt import __version__
from uavbatt.errors import MissingExtra, UsageError
from uavbatt.live.config import HttpSection, address
from uavbatt.live.log import tell
from uavbatt.live.report import NOTHING_YET, Board
from uavbatt.records import Status

EVENT_PERIOD_S = 0.25
START = secrets.token_hex(8)  # differs in every process, because `clock_s` may begin again
SAID_S = 120.0  # an announcement stays on the page for so long
PAGE = Path(__file__).with_name("page.html")
# Metrics of a battery: key of its output line -> name and help of the gauge.
GAUGES = {
    "soc": ("uavbatt_soc_ratio", "State of charge"),
    "voltage_V": ("uavbatt_voltage_volts", "Pack voltage"),
    "current_A": ("uavbatt_current_amperes", "Discharge current"),
    "temp_C": ("uavbatt_temperature_celsius", "Pack temperature"),
    "innovation_V": ("uavbatt_innovation_volts", "Voltage less its prediction"),
    "age_s": ("uavbatt_sample_age_seconds", "Age of the last row"),
    "waiting": ("uavbatt_waiting", "1 on the ground, waiting for take-off: no number is missing"),
}
QUANTILES = {"0.05": "remaining_lo_s", "0.5": "remaining_s", "0.95": "remaining_hi_s"}
COUNTERS = {"rows": "samples", "refused": "forecast_refused"}  # count of the process -> its name where that differs
PROMETHEUS = "text/plain; version=0.0.4; charset=utf-8"
# The menu of a companion computer (BlueOS) shows this about the service (/register_service).
ABOUT = {
    "name": "uavbatt",
    "description": "Remaining flight time",
    "icon": "mdi-battery-clock",
    "webpage": "/",
    "company": "uavbatt",
    "version": __version__,
    "api": "",
}
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)  # the page's script; its data are no script


ReadBoard = Callable[[], Board]
Clock = Callable[[], float]


def content(board: Board, now_s: float) -> dict[str, Any]:
    """Return the content of /now.json and of every event."""
    batteries = [report.as_line(now_s) for report in board.reports]
    first = batteries[0] if batteries else None
    return {
        "status": first["status"] if first else "stale",
        "reason": first["reason"] if first else board.problem or NOTHING_YET,
        "batteries": batteries,
        "notes": list(board.notes),
        "said": [
            {"age_s": round(now_s - at, 1), "text": text} for at, text in board.announcements if now_s - at <= SAID_S
        ],
        "counts": dict(board.counts),
        "clock_s": round(now_s, 2),
        "start": START,
        "version": __version__,
    }


def metrics(board: Board, now_s: float) -> bytes:
    """Return the state in Prometheus' text format; unknown values are NaN."""
    from prometheus_client import CollectorRegistry, Gauge, generate_latest
    from prometheus_client.core import CounterMetricFamily

    registry = CollectorRegistry()
    left = Gauge("uavbatt_remaining_seconds", "Time left in flight", ["battery", "quantile"], registry=registry)
    gauges = {key: Gauge(name, words, ["battery"], registry=registry) for key, (name, words) in GAUGES.items()}
    state = Gauge("uavbatt_status", "1 for the status that holds", ["battery", "status"], registry=registry)
    for report in board.reports:
        line, name = report.as_line(now_s), str(report.instance)
        for quantile, key in QUANTILES.items():
            left.labels(name, quantile).set(_number(line[key]))
        for key, gauge in gauges.items():
            gauge.labels(name).set(_number(line[key]))
        for status in Status:
            state.labels(name, status.value).set(status.value == line["status"])

    class Counters:
        def collect(self) -> list[CounterMetricFamily]:
            return [
                CounterMetricFamily(f"uavbatt_{COUNTERS.get(key, key)}", f"{key} since the start", value=value)
                for key, value in dict(board.counts).items()
            ]

    registry.register(Counters())
    return bytes(generate_latest(registry))


def filled(page: str, board: Board, now_s: float) -> str:
    """Return the page with the current content, so that it shows something before the first event."""
    first = json.dumps({"now": content(board, now_s), "trend": board.trend.lines(now_s)}, allow_nan=False)
    return page.replace('id="first">null<', 'id="first">' + first.replace("<", "\\u003c") + "<", 1)


def security_policy(page: str) -> str:
    """Return the page's content security policy: only its own script, style and events are allowed."""
    scripts = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in _SCRIPT.findall(page))
    allowed = " ".join(f"'sha256-{digest}'" for digest in scripts)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def is_own_name(asked: str, listens: str) -> bool:
    """Return True if a request names this machine itself, so that it cannot come from a foreign page.

    asked : the request's Host header; listens : the host of `--http`. A foreign site can let a name of its own point to
    this address (DNS rebinding), and could read the feed if that name were accepted.
    """
    name = asked[1:].partition("]")[0] if asked.startswith("[") else asked
    name = (name.partition(":")[0] if name.count(":") == 1 else name).lower()
    if ("." not in name and ":" not in name) or name == listens.lower() or name.endswith(".local"):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _is_allowed(request: Any, token: str) -> bool:
    """Return True if a request has the token, in its address or as a bearer, or if no token is set."""
    header = request.headers.get("authorization", "").removeprefix("Bearer ")
    offered = request.query_params.get("token", "") or header
    return not token or hmac.compare_digest(offered.encode(), token.encode())


def _refusal(request: Any, host: str, token: str) -> tuple[str, int] | None:
    """Return the text and the HTTP status with which a request is refused; None if it is answered."""
    if not is_own_name(request.headers.get("host", ""), host):
        return "ask for this page by its address, localhost or NAME.local\n", 421
    return None if _is_allowed(request, token) else ("token wanted\n", 401)


def _is_fresh(board: Board, now_s: float) -> bool:
    """Return True if the first report (of the battery that speaks for the vehicle) is not stale."""
    return bool(board.reports) and not board.reports[0].is_stale(now_s)


async def _events(board: ReadBoard, clock_s: Clock) -> AsyncIterator[dict[str, str]]:
    """Yield the content of the page, one event after another."""
    while True:
        yield {"data": json.dumps(content(board(), clock_s()), allow_nan=False)}
        await asyncio.sleep(EVENT_PERIOD_S)


def application(settings: HttpSection, board: ReadBoard, clock_s: Clock) -> Any:
    """Return the ASGI application. Raises MissingExtra without the extra `web`."""
    try:
        from sse_starlette.sse import EventSourceResponse
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Route
    except ImportError:
        raise MissingExtra("web", "--http") from None

    host, _ = address(settings.listen)

    def guarded(answer: Callable[[Request], Response]) -> Callable[[Request], Any]:
        async def endpoint(request: Request) -> Response:
            refused = _refusal(request, host, settings.token)
            return PlainTextResponse(*refused) if refused is not None else answer(request)

        return endpoint

    async def health(request: Request) -> Response:
        is_fresh = _is_fresh(board(), clock_s())
        return PlainTextResponse("ok\n" if is_fresh else "stale\n", 200 if is_fresh else 503)

    page = PAGE.read_text(encoding="utf-8")
    policy = {"Content-Security-Policy": security_policy(page), "X-Content-Type-Options": "nosniff"}
    return Starlette(
        routes=[
            Route("/", guarded(lambda r: HTMLResponse(filled(page, board(), clock_s()), headers=policy))),
            Route("/now.json", guarded(lambda r: JSONResponse(content(board(), clock_s())))),
            Route("/metrics", guarded(lambda r: Response(metrics(board(), clock_s()), media_type=PROMETHEUS))),
            Route("/events", guarded(lambda r: EventSourceResponse(_events(board, clock_s)))),
            Route("/register_service", guarded(lambda r: JSONResponse(ABOUT))),
            Route("/healthz", health),
        ]
    )


def serve(settings: HttpSection, board: ReadBoard, clock_s: Clock) -> threading.Thread:
    """Serve the page in a thread of its own and return that thread.

    Raises UsageError when the address is taken, MissingExtra without the extra `web`.
    """
    app = application(settings, board, clock_s)
    try:
        import uvicorn

        from uavbatt.live.feeds.connections import MOST_WAITING, protocol
    except ImportError:
        raise MissingExtra("web", "--http") from None
    host, port = address(settings.listen)
    try:
        listener = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        said = os.strerror(error.errno) if error.errno else str(error)
        raise UsageError(f"--http {settings.listen}: {said}") from None
    limits: dict[str, Any] = {"http": protocol(), "backlog": MOST_WAITING}
    quiet: dict[str, Any] = {"log_level": "warning", "access_log": False, "lifespan": "off", "ws": "none"}
    server = uvicorn.Server(uvicorn.Config(app, **limits, **quiet))

    def work() -> None:
        try:
            asyncio.run(server.serve(sockets=[listener]))
        except Exception as error:  # an error of the page must not end the process
            tell(f"page stopped: {error}")

    thread = threading.Thread(target=work, name="page", daemon=True)
    thread.start()
    return thread
