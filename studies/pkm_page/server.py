"""The web side of the page: addresses, answers, events; nothing else knows of the web."""

import asyncio
import dataclasses
import datetime
import ipaddress
import os
import secrets
import socket
import tempfile
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from pkm_page import machine_page, render
from pkm_page.feed import Feed
from pkm_page.guard import Guard, hosts_of
from pkm_page.machine_page import Change, MachinePage, ResultChoice
from pkm_page.new_study import FieldError, NewStudy, StudyForm
from pkm_page.readings_log import StaleError
from pkm_page.session import DoubtfulError, MachineSession, ReadingEntry
from pkm_page.shelf import RESULT, Shelf, study_files
from pkm_studies import files, shipped
from pkm_studies.acceptance import ACCEPTANCE_FILE, judge_folder, verdict_sentences
from pkm_studies.base import InputError
from pkm_studies.results import BadFitError
from pkm_studies.sessions import Adviser
from pkm_studies.study import SUFFIX, Study
from pkm_studies.user_code import Consent

# The acceptance test of a result on the page: the file to fill in, and its judgement.

MAX_BYTES: Final = 1_000_000  #: bytes of a file to fill in


class FilledIn(msgspec.Struct, forbid_unknown_fields=True):
    """A filled-in file as the page sends it, and the key of its result."""

    key: str
    text: str


def acceptance_form(folder: Path) -> str:
    """The file that the plan of the test wrote. Raises InputError where none is."""
    path = folder / ACCEPTANCE_FILE
    if not path.is_file() or path.is_symlink():
        raise InputError("no acceptance test is planned", "plan it first")
    return files.read_text(path, limit=MAX_BYTES, what="acceptance file")


def judge_acceptance(folder: Path, text: str) -> list[str]:
    """The verdict on a filled-in file, then stored. Raises InputError, and stores nothing."""
    with tempfile.TemporaryDirectory(prefix="oed-") as scratch:
        path = files.write_whole(Path(scratch) / ACCEPTANCE_FILE, text)
        try:
            verdict = judge_folder(folder, path)
        except BadFitError as error:
            raise InputError(str(error), "look for the cause first") from error
        except InputError as error:
            raise InputError(
                error.problem, error.remedy, field=error.field, value=error.value
            ) from error
    now = datetime.datetime.now().isoformat(timespec="microseconds").replace(":", "")
    stored = files.write_whole(folder / f"acceptance-measured-{now}.csv", text)
    return [*verdict_sentences(verdict), f"Stored as {stored.name}."]


PAUSE = 0.1  #: time between two looks for news, s
ALIVE = 15.0  #: time from one sign of life to the next, s
MAX_LISTENERS: Final = 32  #: pages that may listen at once
#: status of an answer: in doubt or out of date; not usable; too many
CONFLICT, UNUSABLE, TOO_MANY = 409, 422, 429

FIRST: Final = "hexapod_ups"  #: machine of a new form

Body = TypeVar("Body")


class Switch:
    """The application of a page; in a folder of studies, one of them may be opened.

    start  makes the page of a study's file
    """

    def __init__(
        self,
        page: MachinePage | None,
        shelf: Shelf,
        start: Callable[[Path], MachinePage] | None = None,
    ) -> None:
        self.page, self.shelf, self.start = page, shelf, start
        self.app = self._application()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer by the application of now."""
        await self.app(scope, receive, send)

    def open(self, study: Path) -> None:
        """Go on with the page of a study. Raises InputError for one without advice."""
        if self.start is None:
            raise InputError("no study is opened here", "serve a folder")
        before, self.page = self.page, self.start(study)
        if before is not None:
            before.stop()
        self.app = self._application()

    def _application(self) -> Starlette:
        results = ResultAddresses(self.shelf, self if self.start is not None else None)
        first = [Route("/", results.show)]
        if self.page is not None:
            first = MachineAddresses(self.page).routes
        handlers = {404: _absent, 405: _absent}
        return Starlette(routes=[*first, *results.routes], exception_handlers=handlers)


class MachineAddresses:
    """Addresses of the measuring page."""

    def __init__(self, page: MachinePage) -> None:
        self.page = page
        self.listeners = threading.BoundedSemaphore(MAX_LISTENERS)
        self.routes = [
            Route("/", self.show),
            Route("/state", self.state),
            Route("/events", self.events),
            Route("/readings.csv", self.readings),
            *(
                _posting(f"/{name}", kind, work, page.state)
                for name, kind, work in self._changes()
            ),
        ]

    def _changes(self) -> list[tuple[str, Any, Callable[[Any], Any]]]:
        page, session = self.page, self.page.session
        return [
            ("reading", ReadingEntry, page.take),
            ("undo", Change, lambda c: session.undo(c.version)),
            ("remark", Change, lambda c: session.remark(c.version, c.text)),
            ("skip", Change, lambda c: session.skip(c.version, c.text)),
            ("unskip", Change, lambda c: session.take_skip_back(c.version)),
            ("repeat", Change, lambda c: session.repeat(c.version, again=c.again)),
            ("fit", ResultChoice, lambda c: page.fit(c.word)),
            ("acceptance", ResultChoice, lambda c: page.plan_acceptance(c.key)),
        ]

    def show(self, _: Request) -> Response:
        """The whole page."""
        page = self.page
        study = page.session.adviser.base.study
        html, headers = render.document(
            "machine",
            study=study.name,
            title=study.title or study.name,
            file=page.session.log.path.name,
            state=page.state(),
            data=render.encoded_state(page.state()),
        )
        return HTMLResponse(html, headers=headers)

    def state(self, _: Request) -> Response:
        """The state of the session."""
        return _answer(self.page.state())

    def readings(self, _: Request) -> Response:
        """The readings file as it is on the disk."""
        path = self.page.session.log.path
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return _answer({"error": "There is no reading yet."}, UNUSABLE)
        name = "".join(c if c.isalnum() or c in "-_." else "_" for c in path.name)
        kind = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(data, media_type="text/csv", headers=kind)

    async def events(self, _: Request) -> Response:
        """A line whenever the state has changed."""
        if not self.listeners.acquire(blocking=False):
            return _answer({"error": "Too many pages are open."}, TOO_MANY)
        return StreamingResponse(self._news(), media_type="text/event-stream")

    async def _news(self) -> AsyncIterator[str]:
        try:
            before, silent = "", 0.0
            while True:
                token = self.page.token()
                if token != before:
                    before = token
                    silent = 0.0
                    yield "data: changed\n\n"
                elif silent >= ALIVE:
                    silent = 0.0
                    yield ": alive\n\n"
                await asyncio.sleep(PAUSE)
                silent += PAUSE
        finally:
            self.listeners.release()


class ResultAddresses:
    """Addresses of stored results: cards, reports, two side by side, files to send."""

    def __init__(self, shelf: Shelf, switch: Switch | None = None) -> None:
        self.shelf, self.switch = shelf, switch
        self.routes = [
            *([] if switch is None else StudyAddresses(shelf.root, switch).routes),
            Route("/results", self.show),
            Route("/results/{key}/report", self.report),
            Route("/results/{first}/beside/{second}", self.side_by_side),
            Route("/results/{key}/acceptance", self.acceptance),
            _posting("/compensation", ResultChoice, self._compensation),
            _posting("/judge", FilledIn, self._judge, lambda: {"sentences": []}),
        ]

    def show(self, _: Request) -> Response:
        """All results as cards."""
        cards = self.shelf.cards()
        html, headers = render.document(
            "results",
            cards=cards,
            left_out=self.shelf.found - len(cards),
            folder=self.shelf.root.resolve().name,
            formats=machine_page.format_names(),
            studies=self._studies(),
        )
        return HTMLResponse(html, headers=headers)

    def _studies(self) -> list[tuple[str, str]] | None:
        """Keys and names of the studies that can be opened here; None where none can."""
        if self.switch is None:
            return None
        available = study_files(self.shelf.root)
        return [(key, path.name) for key, path in available.items()]

    def report(self, request: Request) -> Response:
        """The report of a result, apart from everything else."""
        key = request.path_params["key"]
        return _stored(lambda: machine_page.stored_report(self.shelf.folder(key)))

    def side_by_side(self, request: Request) -> Response:
        """Two results side by side."""
        keys = [request.path_params[name] for name in ("first", "second")]
        return _stored(
            lambda: machine_page.comparison([self.shelf.folder(key) for key in keys])
        )

    def acceptance(self, request: Request) -> Response:
        """The file of a planned acceptance test, to fill in."""
        try:
            text = acceptance_form(self.shelf.folder(request.path_params["key"]))
        except (InputError, OSError) as error:
            return _answer({"error": str(error)}, UNUSABLE)
        kind = {"Content-Disposition": 'attachment; filename="acceptance.csv"'}
        return Response(text, media_type="text/csv", headers=kind)

    def _judge(self, filled: FilledIn) -> dict[str, Any]:
        """The verdict on a filled-in file of an acceptance test."""
        folder = self.shelf.folder(filled.key)
        return {"sentences": judge_acceptance(folder, filled.text)}

    def _compensation(self, choice: ResultChoice) -> dict[str, Any]:
        """The files of a controller's format for a result."""
        folder = self.shelf.folder(choice.key)
        return machine_page.compensation_files(folder, choice.word)


class StudyAddresses:
    """Addresses of a folder of studies: a form for a new one, and one to go on with."""

    def __init__(self, folder: Path, switch: Switch) -> None:
        self.folder = folder
        self.switch = switch
        self.form = StudyForm(folder)
        self.routes = [
            Route("/new", self.show),
            _posting("/new", NewStudy, self._write),
            _posting("/new/draw", NewStudy, self._draw),
            _posting("/open", ResultChoice, self._open),
        ]

    def show(self, request: Request) -> Response:
        """The form, for the machine of the query."""
        names = self.form.machines()
        machine = request.query_params.get("machine", FIRST)
        if machine not in names:
            return Response("There is no such machine.\n", 404, media_type="text/plain")
        html, headers = render.document(
            "new",
            folder=self.folder.resolve().name,
            machines=names,
            machine=machine,
            families=[name for name in names if self.form.sizes(name)],
            sizes=self.form.sizes(machine),
            instruments=self.form.instruments(machine),
            components=self.form.components(machine),
        )
        return HTMLResponse(html, headers=headers)

    def _draw(self, form: NewStudy) -> dict[str, Any]:
        return {"view": msgspec.to_builtins(self.form.drawing(form))}

    def _write(self, form: NewStudy) -> dict[str, Any]:
        path = self.form.write(form)
        self.switch.open(path)
        return {"file": path.name}

    def _open(self, choice: ResultChoice) -> dict[str, Any]:
        available = study_files(self.folder)
        if choice.key not in available:
            raise InputError("there is no such study", "load the page again")
        self.switch.open(available[choice.key])
        return {}


def _posting(
    path: str,
    kind: type[Body],
    work: Callable[[Body], dict[str, Any] | None],
    state: Callable[[], dict[str, Any]] = dict,
) -> Route:
    """An address that takes a body, and answers with `state` and what the work returns."""

    def worked(body: bytes) -> Response:
        status, further = _attempt(body, kind, work)
        return _answer(state() | further, status)

    async def answer(request: Request) -> Response:
        return await run_in_threadpool(worked, await request.body())

    return Route(path, answer, methods=["POST"])


def _attempt(
    body: bytes, kind: type[Body], work: Callable[[Body], dict[str, Any] | None]
) -> tuple[int, dict[str, Any]]:
    """Status and keys of the answer to a posted body."""
    try:
        return 200, work(msgspec.json.decode(body, type=kind)) or {}
    except msgspec.DecodeError as error:
        return 400, {"error": f"This is no request of the page: {error}."}
    except DoubtfulError as doubt:
        return CONFLICT, {"doubts": doubt.sentences}
    except StaleError:
        return CONFLICT, {"error": "The readings changed meanwhile: look again."}
    except FieldError as error:
        return UNUSABLE, {"error": str(error), "field": error.name}
    except InputError as error:
        return UNUSABLE, {"error": str(error)}
    except OSError as error:
        return UNUSABLE, {"error": f"{files.refusal(error)} Nothing was taken."}


def _answer(values: dict[str, Any], status: int = 200) -> Response:
    data = msgspec.json.encode(values).replace(
        b"<", b"\\u003c"
    )  # no page, whoever opens it
    return Response(data, status_code=status, media_type="application/json")


def _stored(make: Callable[[], str]) -> Response:
    """A stored page in a place of its own, or the error in its place."""
    try:
        html = make()
    except InputError as error:
        return Response(f"{error}\n", status_code=404, media_type="text/plain")
    policy = {"Content-Security-Policy": render.report_policy()}
    return HTMLResponse(html, headers=policy)


async def _absent(_: Request, __: Exception) -> Response:
    return Response(
        "There is no such page.\n", status_code=404, media_type="text/plain"
    )


# Opens a study or results on a local address, and serves the page until it is stopped.

LOCAL: Final = "127.0.0.1"
TOKEN_BYTES: Final = 24  #: bytes of a token
SHUTDOWN_SECONDS: Final = 1  #: seconds that open pages have at the end


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
    """The page of a study, a result or a folder of results. Raises InputError."""
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
        study = Study.load(path, Consent.RECORDED)
        adviser = Adviser(study, options.wanted)
        folder = path.parent / study.name
        page = MachinePage(MachineSession(adviser, folder / "poses.csv"), path, folder)
        page.watch()
        return page

    return start


def _study(target: Path, consent: Consent) -> tuple[Study, Path, Path]:
    if not target.is_dir():
        study = Study.load(shipped.study_path(target), consent)
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
    token = "" if _is_local(host) else secrets.token_urlsafe(TOKEN_BYTES)
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
        timeout_graceful_shutdown=SHUTDOWN_SECONDS,
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
