"""A served page that the tests of a module share: see `page_server`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from page import page_server
from pkm_page import PageOptions


@pytest.fixture(scope="module")
def page_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "mine.study.toml"
    path.write_text(page_server.STUDY, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(page_study: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A served page and its client; tests of a module share them."""
    readings = tmp_path_factory.mktemp("machine") / "poses.csv"
    options = PageOptions(readings)
    with page_server.served(page_study, options) as (opened, port):
        yield opened, page_server.Client(port)


@pytest.fixture
def machine(page: Any) -> Any:
    """The page without any reading, its client and an operator."""
    opened, client = page
    opened.session.log.path.unlink(missing_ok=True)
    opened.session.refresh()
    return opened, client, page_server.Operator(opened)
