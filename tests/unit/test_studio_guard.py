"""Who may talk to the studio."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ringtrue.studio.launch import Guard

TOKEN = "a-token"
COOKIE = f"ringtrue-studio-8000={TOKEN}"


def asked(kind: str = "http", query: str = "", **headers: str) -> list[dict[str, Any]]:
    """What is sent to a request, `passed` where it reaches the studio."""
    sent: list[dict[str, Any]] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        sent.append({"passed": True})
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message: Any) -> None:
        sent.append(message)

    given = {"host": "127.0.0.1:8000"} | headers
    scope = {
        "type": kind,
        "query_string": query.encode(),
        "headers": [(k.encode(), v.encode()) for k, v in given.items()],
    }
    guard = Guard(app, TOKEN, 8000)
    asyncio.run(guard(scope, None, send))  # type: ignore[arg-type]
    return sent


def test_the_token_of_the_address_becomes_a_cookie() -> None:
    sent = asked(query=f"token={TOKEN}")
    assert sent[0] == {"passed": True}
    held = dict(sent[1]["headers"])[b"set-cookie"].decode()
    assert held.startswith(COOKIE)
    assert "HttpOnly" in held
    assert "SameSite=Strict" in held
    assert asked(cookie=COOKIE)[0] == {"passed": True}
    assert asked("websocket", cookie=COOKIE, origin="http://127.0.0.1:8000")[0][
        "passed"
    ]


@pytest.mark.parametrize(
    ("query", "headers"),
    [
        ("", {}),
        ("token=another", {}),
        ("", {"cookie": "ringtrue-studio-8000=another"}),
        ("", {"cookie": COOKIE, "host": "evil.example:8000"}),
        ("", {"cookie": COOKIE, "origin": "http://evil.example"}),
        ("", {"cookie": COOKIE, "origin": "null"}),
        (f"token={TOKEN}", {"origin": "http://127.0.0.1:9000"}),
    ],
)
def test_others_are_refused(query: str, headers: dict[str, str]) -> None:
    assert [m.get("status") for m in asked("http", query, **headers)] == [403, None]
    (closed,) = asked("websocket", query, **headers)
    assert closed["type"] == "websocket.close"
