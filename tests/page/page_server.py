"""A page at the machine on a free port, and a client that speaks HTTP by itself."""

import contextlib
import csv
import http.client
import json
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import sample
import uvicorn

from oed.base import Array
from oed.measurement import draw_parameters
from pkm_page import server
from pkm_page.guard import Guard, hosts_of
from pkm_page.machine_page import MachinePage
from pkm_page.server import Switch

STUDY = sample.changed(
    sample.STUDY,
    (
        "[design]",
        "[prediction]\nz_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = 20.0\n\n[design]",
    ),
)


@contextlib.contextmanager
def served(
    target: Path, options: server.PageOptions, token: str = ""
) -> Iterator[tuple[MachinePage | None, int]]:
    """The page of a target in a thread of this process, and its port."""
    opened, shelf = server.open_page(target, options)
    listening = server._listen("127.0.0.1", 0)
    port = listening.getsockname()[1]
    app = Guard(
        Switch(opened, shelf, None if opened is not None else server.starter(options)),
        hosts_of(["127.0.0.1"], port),
        token,
    )
    config = uvicorn.Config(
        app,
        log_level="critical",
        lifespan="off",
        ws="none",
        timeout_graceful_shutdown=1,
    )
    listener = uvicorn.Server(config)
    thread = threading.Thread(target=listener.run, args=([listening],), daemon=True)
    thread.start()
    while not listener.started:
        time.sleep(0.01)
    yield opened, port
    listener.should_exit = True
    thread.join()


class Client:
    """Requests as a browser's page makes them; `heads` replace or remove its headers."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(
        self, method: str, path: str, body: bytes | None = None, **heads: str | None
    ) -> tuple[int, bytes, dict[str, str]]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        headers: dict[str, str | None] = {"Host": f"127.0.0.1:{self.port}"}
        if method not in ("GET", "HEAD"):
            headers["Origin"] = f"http://127.0.0.1:{self.port}"
            headers["Content-Type"] = "application/json"
        headers |= {name.replace("_", "-"): value for name, value in heads.items()}
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in headers.items():
            if value is not None:
                connection.putheader(name, value)
        if body is not None and "Content-Length" not in headers:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        result = answer.status, answer.read(), dict(answer.getheaders())
        connection.close()
        return result

    def state(self) -> dict[str, Any]:
        return dict(json.loads(self.ask("GET", "/state")[1]))

    def post(self, path: str, **values: Any) -> tuple[int, dict[str, Any]]:
        status, data, _ = self.ask("POST", path, json.dumps(values).encode())
        return status, json.loads(data)


def take(client: Client, entries: list[str], **more: Any) -> tuple[int, dict[str, Any]]:
    """Send a reading for the state that the server has now."""
    version = client.state()["version"]
    values: dict[str, Any] = {"version": version, "key": str(random.random())}
    return client.post("/reading", **(values | {"entries": entries} | more))


def rows(path: Path) -> list[dict[str, str]]:
    """Rows of a readings file below its comments."""
    lines = path.read_text("utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


class Operator:
    """Who reads a virtual machine at the pose that a session asks for."""

    def __init__(self, opened: MachinePage, seed: int = 5) -> None:
        self.session = opened.session
        self.rng = np.random.default_rng(seed)
        machine = self.session.measurement
        self.truth: Array = draw_parameters(machine, self.rng)

    def display(self) -> list[str]:
        """What the instrument shows at the present pose, mm, four decimals."""
        pose = self.session.state.pose
        one = [pose.series]
        machine = self.session.measurement
        noise = machine.sigma(one) * self.rng.standard_normal(len(machine.sigma(one)))
        y = machine.readings(one, self.truth) + noise
        return [f"{1e3 * value:.4f}" for value in y]
