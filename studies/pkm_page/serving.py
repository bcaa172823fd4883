"""Opens a study or results on a local address, and serves the page until it is stopped."""

from __future__ import annotations

import dataclasses
import ipaddress
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Final

import uvicorn

from pkm_page.feed import Feed
from pkm_page.guard import Guard, hosts_of
from pkm_page.machine_page import MachinePage
from pkm_page.server import Switch
from pkm_page.session import MachineSession
from pkm_page.shelf import RESULT, Shelf
from pkm_studies import shipped
from pkm_studies.base import InputError
from pkm_studies.sessions import Adviser
from pkm_studies.study import SUFFIX, Study, load
from pkm_studies.user_code import Consent

LOCAL: Final = "127.0.0.1"
#: bytes of a token
SECRET: Final = 24
#: seconds that open pages have at the end
END: Final = 1


@dataclasses.dataclass(frozen=True)
class PageOptions:
    """What `oed serve` was asked for.

    readings  file of the readings; poses.csv of the results' folder by default
    wanted    as that of `oed next`
    source, pattern, take  readings that arrive as lines: see `Feed`
    """

    readings: Path | None = None
    wanted: str = ""
    source: str = ""
    pattern: str = ""
    take: bool = False
    consent: Consent = Consent.RECORDED


def open_page(target: Path, options: PageOptions) -> tuple[MachinePage | None, Shelf]:
    """The page of a study, of a result, or of a folder of results.

    Raises InputError where the study cannot be measured by advice.
    """
    if target.is_dir() and not (target / RESULT).is_file():
        if options.readings is not None or options.source:
            raise InputError(
                "a folder of results is measured at no machine",
                "name a study, or a folder with a result.json",
                value=str(target),
            )
        return None, Shelf(target)
    study, file, folder = _study(target, options.consent)
    readings = folder / "poses.csv"
    if options.readings is not None:
        readings = options.readings
        folder = readings.parent
    adviser = Adviser(study, options.wanted)
    page = MachinePage(MachineSession(adviser, readings), file, folder)
    if options.source:
        page.feed = Feed(options.source, options.pattern, page.arrived)
        page.take_at_once = options.take
    return page, page.shelf


def starter(options: PageOptions) -> Callable[[Path], MachinePage]:
    """What opens a study of a served folder, with its results in a folder beside it."""

    def start(path: Path) -> MachinePage:
        study = load(path, Consent.RECORDED)
        adviser = Adviser(study, options.wanted)
        folder = path.parent / study.name
        page = MachinePage(MachineSession(adviser, folder / "poses.csv"), path, folder)
        page.watch()
        return page

    return start


def _study(target: Path, consent: Consent) -> tuple[Study, Path, Path]:
    """The study, its file, and the folder of its results."""
    if not target.is_dir():
        study = load(shipped.study_path(target), consent)
        return study, target, Path("out") / study.name
    from oed.safe_files import write_own
    from pkm_studies.compensation import result_study
    from pkm_studies.results import load_result

    result = load_result(target)
    study = result_study(result, target, None)
    path = write_own(target / f"{result.study}{SUFFIX}", result.study_text.encode())
    return study, path, target


def serve(
    target: Path, options: PageOptions, host: str, port: int, say: Callable[[str], None]
) -> None:
    """Serve until the process is interrupted. `say` is given the address to open."""
    page, shelf = open_page(target, options)
    listening = _listen(host, port)
    port = listening.getsockname()[1]
    token = "" if _is_local(host) else secrets.token_urlsafe(SECRET)
    names = [LOCAL, "localhost", "::1"] if not token else _names(host)
    switch = Switch(page, shelf, None if page is not None else starter(options))
    app = Guard(switch, hosts_of(names, port), token)
    config = uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,
        server_header=False,
        lifespan="off",
        ws="none",
        timeout_graceful_shutdown=END,
        limit_concurrency=100,
        h11_max_incomplete_event_size=16_384,
        http="h11",
        proxy_headers=False,
    )
    if page is not None:
        page.watch()
        if page.feed is not None:
            page.feed.start()
    query = f"?token={token}" if token else ""
    shown = names[0] if ":" not in names[0] else f"[{names[0]}]"
    say(f"http://{shown}:{port}/{query}")
    try:
        uvicorn.Server(config).run(sockets=[listening])
    finally:
        if switch.page is not None:
            switch.page.stop()


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises InputError where the address cannot be had."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        if os.name != "nt":
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(128)
    except OSError as error:
        raise InputError(
            f"no page can be served there: {(error.strerror or str(error)).lower()}",
            "take another --port, or --host an address of this computer",
            value=f"{host}:{port}",
        ) from error
    return listening


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _names(host: str) -> list[str]:
    """Names under which other computers reach this one, the most useful first."""
    every = host in ("0.0.0.0", "::", "")
    name = socket.gethostname()
    addresses = _addresses() if every else [host]
    return list(dict.fromkeys([*addresses, name, f"{name}.local"]))


def _addresses() -> list[str]:
    """This computer's addresses, that towards the network first."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: documentation address
            outward = [str(probe.getsockname()[0])]
        except OSError:
            outward = []
    try:
        listed = [str(a[4][0]) for a in socket.getaddrinfo(socket.gethostname(), None)]
    except OSError:
        listed = []
    return list(dict.fromkeys([*outward, *listed, LOCAL]))
