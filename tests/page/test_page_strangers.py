"""What strangers send to the page: 500 requests, scripts in remarks, no token."""

import json
import random
from collections.abc import Callable, Mapping
from typing import Any

from page.page_server import Client, rows, served, take
from pkm_page import server

Request = Mapping[str, Any]
SCRIPT = "<script>alert(1)</script>"
GOOD = {"version": "absent", "key": "k", "entries": ["300"], "confirmed": True}
PATHS = (
    "/reading", "/undo", "/remark", "/fit", "/compensation", "/acceptance", "/judge",
    "/skip",
)  # fmt: skip
BAD: tuple[Any, ...] = (
    {**GOOD, "entries": [SCRIPT]},
    {**GOOD, "version": SCRIPT},
    {**GOOD, "path": "/etc/passwd"},
    {**GOOD, "entries": "300"},
    [],
    {"keys": ["../.."], "word": "csv"},
    {"keys": ["x"], "word": "../evil.py:run"},
)


def post(rng: random.Random, body: bytes, **heads: Any) -> Request:
    return {"method": "POST", "path": rng.choice(PATHS), "body": body, **heads}


def outside(rng: random.Random, _: int) -> Request:
    """A path that climbs out of the folder."""
    steps = ("../", "..%2f", "%2e%2e/", "..\\")
    ups = "".join(rng.choice(steps) for _ in range(rng.randint(1, 6)))
    tail = rng.choice(["etc/passwd", "poses.csv", "result.json", "mine.study.toml"])
    return {
        "method": "GET",
        "path": f"/{rng.choice(['', 'results/', 'static/'])}{ups}{tail}",
    }


def noise(rng: random.Random, _: int) -> Request:
    return post(rng, rng.randbytes(rng.randint(0, 300)))


def of_other_origin(rng: random.Random, port: int) -> Request:
    origins = (
        "http://evil.example", "null", f"https://127.0.0.1:{port}", "http://127.0.0.1",
        None,
    )  # fmt: skip
    return post(rng, json.dumps(GOOD).encode(), Origin=rng.choice(origins))


def of_other_host(rng: random.Random, port: int) -> Request:
    """A name of a stranger's name server that points here."""
    hosts = (
        "evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1.evil:{port}",
        f"0.0.0.0:{port}",
    )  # fmt: skip
    return {
        "method": "GET",
        "path": rng.choice(["/", "/state", "/readings.csv"]),
        "Host": rng.choice(hosts),
    }


def too_large(rng: random.Random, _: int) -> Request:
    return post(rng, b"x" * rng.randint(16_385, 200_000))


def of_a_form(rng: random.Random, _: int) -> Request:
    kinds = (
        "text/plain", "multipart/form-data", "application/x-www-form-urlencoded", None,
    )  # fmt: skip
    return post(rng, json.dumps(GOOD).encode(), Content_Type=rng.choice(kinds))


def of_other_method(rng: random.Random, _: int) -> Request:
    method = rng.choice(["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
    return {"method": method, "path": rng.choice(["/", *PATHS]), "body": b"{}"}


def malformed(rng: random.Random, _: int) -> Request:
    return post(rng, json.dumps(rng.choice(BAD)).encode())


def across_sites(rng: random.Random, _: int) -> Request:
    site = rng.choice(["cross-site", "same-site"])
    return {
        "method": "GET",
        "path": "/state",
        "Sec_Fetch_Site": site,
        "Sec_Fetch_Mode": "no-cors",
    }


def of_no_result(rng: random.Random, _: int) -> Request:
    keys = ("%3Cscript%3Ealert(1)", "%00", "x" * 600, "..", "a/beside/b", "%2e%2e")
    return {"method": "GET", "path": f"/results/{rng.choice(keys)}/report"}


KINDS: tuple[Callable[[random.Random, int], Request], ...] = (
    outside, noise, of_other_origin, of_other_host, too_large, of_a_form, of_other_method,
    malformed, across_sites, of_no_result,
)  # fmt: skip


def test_strangers_are_refused(machine):
    """500 requests: nothing is written, nothing but refusals comes back."""
    opened, client, _ = machine
    rng = random.Random(3)
    folder = opened.session.log.path.parent
    before = {p.name for p in folder.iterdir()}
    for _ in range(500):
        request = dict(rng.choice(KINDS)(rng, client.port))
        status, data, heads = client.ask(
            request.pop("method"),
            request.pop("path"),
            request.pop("body", None),
            **request,
        )
        assert 400 <= status < 500, (request, status)
        assert b"root:" not in data
        assert b"<script>alert" not in data
        assert "x-powered-by" not in heads
    assert not opened.session.log.path.exists()
    assert {p.name for p in folder.iterdir()} - before <= {".poses.csv.lock"}
    assert not opened.job.state.name


def test_an_address_has_at_most_512_characters(machine):
    """Of the path and of the query together, without the question mark."""
    _, client, _ = machine
    for start, answer in (("/state?", 200), ("/", 404)):
        longest = start + "x" * (512 - len(start.rstrip("?")))
        assert client.ask("GET", longest)[0] == answer
        assert client.ask("GET", f"{longest}x")[0] == 414


def test_a_script_in_a_remark_is_text(machine):
    opened, client, operator = machine
    script = "</script><script>alert(1)</script>\n=cmd|'/c calc'!A1"
    take(client, operator.display(), remark=script)
    client.post("/remark", version=client.state()["version"], text=f"={script}")
    _, data, heads = client.ask("GET", "/")
    assert b"<script>alert" not in data
    assert data.count(b"</script>") == 2
    assert "script-src 'sha256-" in heads["content-security-policy"]
    assert (
        "unsafe-inline"
        not in heads["content-security-policy"].partition("script-src")[2]
    )
    (row,) = rows(opened.session.log.path)
    assert row["remark"].startswith("'=")


def test_other_computers_need_the_token(page_study, tmp_path):
    with served(
        page_study, server.PageOptions(tmp_path / "poses.csv"), token="right"
    ) as (_, port):
        client = Client(port)
        for path in ("/", "/state", "/events", "/?token=wrong", "/readings.csv"):
            assert client.ask("GET", path)[0] == 401
        assert client.ask("GET", "/", Cookie="oed_token=wrong")[0] == 401
        assert client.ask("POST", "/undo", b"{}")[0] == 401
        status, _, heads = client.ask("GET", "/?token=right")
        assert status == 303
        cookie = heads["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=strict" in cookie
        assert client.ask("GET", "/state", Cookie=cookie.partition(";")[0])[0] == 200
