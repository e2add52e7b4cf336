"""Who may use the studio."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient

from cabinpose.app.studio.access import COOKIE, Guard, in_address
from cabinpose.app.studio.serve import serve
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core.errors import ConfigError


def client(token: str | None, host: str = "127.0.0.1:8570") -> TestClient:
    app = FastAPI()

    @app.get("/")
    def index() -> str:
        return "here"

    app.add_middleware(Guard, token=token)
    return TestClient(app, base_url=f"http://{host}")


@pytest.mark.parametrize("host", ["127.0.0.1:8570", "localhost:1", "localhost", "[::1]:9"])
def test_this_machine_may_look_by_its_own_name(host: str) -> None:
    assert client(None).get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("host", ["evil.example:8570", "192.168.1.7:8570", "127.0.0.1.evil.example", ""])
def test_other_names_are_refused(host: str) -> None:
    assert client(None).get("/", headers={"host": host}).status_code == 403


def test_script_of_another_page_is_refused() -> None:
    assert client(None).get("/", headers={"origin": "http://evil.example"}).status_code == 403
    assert client(None).get("/", headers={"origin": "http://127.0.0.1:8570"}).status_code == 200


def test_token_is_needed_and_kept() -> None:
    studio = client("secret", "studio.example")
    assert studio.get("/").status_code == 403
    assert studio.get("/?token=wrong").status_code == 403
    answer = studio.get("/?token=secret")
    assert answer.status_code == 200
    assert COOKIE in answer.cookies
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert studio.get("/").status_code == 200  # by the cookie


@pytest.mark.parametrize("token", ["a+b", "a&token=b", "a#b", "a%20b", "a b", 'a;b,"c"', "Schlüssel", "密码"])
def test_token_of_any_letters_is_accepted_and_kept(token: str) -> None:
    studio = client(token, "studio.example")
    assert studio.get(f"/?token={in_address(token)}").status_code == 200
    assert studio.get("/").status_code == 200  # by the cookie
    assert studio.get(f"/?token={in_address(token + '+')}").status_code == 403
    assert client("a+b").get("/?token=a+b").status_code == 200  # as somebody types it


@pytest.mark.parametrize("token", ["", " ", "two\nlines", "\udce4"])
def test_token_that_no_browser_can_bring_is_refused(run: Callable[..., Any], token: str) -> None:
    outcome = run("studio", "--token", token, "--port", 0)
    assert outcome.code == 2
    assert "hint: give letters and digits" in outcome.err


def test_origin_that_is_none_is_refused() -> None:
    assert client(None).get("/", headers={"origin": "http://[::1"}).status_code == 403


def test_beyond_this_machine_only_with_a_token(run: Callable[..., Any]) -> None:
    with pytest.raises(ConfigError, match="open to other machines"):
        serve(Workspace(), host="0.0.0.0")
    outcome = run("studio", "--host", "0.0.0.0")
    assert outcome.code == 2
    assert "--token" in outcome.err


def test_port_that_is_taken_is_told(run: Callable[..., Any]) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        outcome = run("studio", "--port", taken.getsockname()[1])
    assert outcome.code == 2
    assert "cannot be listened on" in outcome.err


def test_a_number_that_is_no_port_is_refused(run: Callable[..., Any], dataset_folder: Path) -> None:
    outcome = run("studio", dataset_folder, "--port", 70000)
    assert (outcome.code, "70000 cannot be listened on (bind(): port must be 0-65535" in outcome.err) == (2, True)


def test_what_is_of_a_dataset_is_refused_without_one(run: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("scene: {cars: [suv]}\n")
    for flag in ("--predictions", "--labels"):
        outcome = run("studio", tmp_path / "scene.yaml", flag, tmp_path / "file.jsonl", "--port", 0)
        assert (outcome.code, f"{flag} is of a dataset, and none is opened" in outcome.err) == (2, True)
